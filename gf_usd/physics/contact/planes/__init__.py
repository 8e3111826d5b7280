"""Contact planes: their data, their carriers, and continuity between detections."""
