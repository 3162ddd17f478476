"""Turn configs into runs, results and tables: the only package that knows Hydra."""
