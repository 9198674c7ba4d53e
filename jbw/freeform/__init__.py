"""A joint without a form: parallel sliders of any strengths, from frequency and damping alone."""
