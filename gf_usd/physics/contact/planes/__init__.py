"""Contact planes: their data, their support triangles, and continuity between detections."""
