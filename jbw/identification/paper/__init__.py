"""What is the paper's alone: Steps 3 and 4 by its cut, for the law of Bouc and Wen."""
