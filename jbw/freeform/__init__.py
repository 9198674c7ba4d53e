"""A joint's law without an assumed form: parallel sliders, from frequency and damping alone."""
