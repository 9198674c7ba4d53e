"""The procedure of the paper, step by step, and the joint posterior."""
