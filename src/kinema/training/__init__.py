"""Wire models to Lightning: batch -> loss -> log, and the callbacks around it."""
