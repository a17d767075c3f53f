"""Drives that people watch: frames, videos, outcomes."""
