"""The steps of the paper's procedure and the fit of the joint posterior."""
