"""Fit one stage of one method or evaluator: `python train.py stage=generator method=mardm_sit data=open_mocap`."""

from kinema.experiments.entry import train

if __name__ == "__main__":
    train()
