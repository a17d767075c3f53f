"""Sequence PPO, its rollout storage, checkpoints and runs."""
