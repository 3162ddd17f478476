"""Hold what generators share that diffuse whole sequences of frames: MDM, MotionDiffuse and their kin."""
