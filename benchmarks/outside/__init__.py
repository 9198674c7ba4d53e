"""Records and campaigns of a joint from outside jbw, and what jbw says of them."""
