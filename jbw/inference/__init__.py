"""How we learn: sees a log density, names and bounds; knows no joint and no rig."""
