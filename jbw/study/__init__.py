"""The identification of a campaign, from its tests to everything that is saved."""
