"""Steps 3 and 4 of Teloli et al. for the Bouc-Wen law; earlier results are fixed at their means."""
