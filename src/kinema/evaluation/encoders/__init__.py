"""Embed motion and text in one space: the T2M-style matching evaluator and the CLIP-style contrastive one."""
