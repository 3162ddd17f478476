"""Draw motion: strips of poses, videos and pages with a 3D player."""
