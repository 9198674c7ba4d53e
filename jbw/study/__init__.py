"""The identification of a campaign, from the check of its tests to the saved results."""
