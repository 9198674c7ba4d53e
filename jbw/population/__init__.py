"""The population of nominally equal units: their runs collected, and the variation between them."""
