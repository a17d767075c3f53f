"""Supervised perception: camera frames with their truth, the segmentation head, its losses and its scores."""
