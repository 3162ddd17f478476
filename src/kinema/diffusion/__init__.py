"""Hold the generative processes (DDPM, flow): schedules, solvers and guidance over a `predict` callable."""
