"""What is the paper's alone: the smoothed law, its kernels and what follows from them."""
