"""Several units of one joint: their runs collected, and what scatters between them."""
