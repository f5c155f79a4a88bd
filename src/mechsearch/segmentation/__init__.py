"""Segmentation of the target: views of it and one RGB-D image in, its mask and a confidence out."""
