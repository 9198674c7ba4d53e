"""The steps of the procedure of Teloli et al., and the fit of the joint posterior."""
