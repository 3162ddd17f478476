"""Geometry of motion: skeletons, features and back, statistics, representation, checks. No learning, no data sets.

Import from the modules (`kinema.motion.skeleton`, `.features`, `.recovery`, ...): only those that compute in torch
import it.
"""
