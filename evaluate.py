"""Score one row of a table: `python evaluate.py source=generation method=mardm_sit data=open_mocap`."""

from kinema.experiments.entry import evaluate

if __name__ == "__main__":
    evaluate()
