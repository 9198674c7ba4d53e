"""Loading and checking of campaign files, and their schema."""
