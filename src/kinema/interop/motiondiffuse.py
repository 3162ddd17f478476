"""Load and write MotionDiffuse's published denoiser (`latest.tar`, entry `encoder`; MotionDiffuse)."""
