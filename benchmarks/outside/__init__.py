"""Records and campaigns that are simulated without jbw, and what jbw reports on them."""
