"""Latency of the pipeline and of its stages."""
