"""Read and write motion as files; no geometry of their own."""
