"""Named effects, one file each; a plant lists those it has."""
