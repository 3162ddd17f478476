"""Keep runs on disk: their folders, weights and parts, and what builds a model again."""
