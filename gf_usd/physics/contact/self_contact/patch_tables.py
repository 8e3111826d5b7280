"""The tables of patches and of their pairs that `patch_kernels` fills, and its thresholds."""

OPPOSED = 0.5  # cosine above which two patches, or two walls of a gap, face each other
FOLD = 0.25  # increase of that cosine above which neighboring patches count as folded
CREASE = 0.75  # increase of that cosine up to which a fold may close before the next detection
CHANGE = 0.5  # of a relative speed: how much a velocity may change before the next detection

# Columns per patch, and per pair.
CENTER, NORMAL, MEAN, TURNED, RADIUS, SPREAD, PATCH_COLUMNS = 0, 3, 6, 9, 12, 13, 14
GAP, RATE, COSINE, UNTIL, FOLD_TIME, PAIR_COLUMNS = 0, 1, 2, 3, 4, 5

NEIGHBORS, FOLDS = 1, 2  # flags of a pair at rest: neighbors, and not the walls of a gap
