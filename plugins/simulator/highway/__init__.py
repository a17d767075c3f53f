"""The embedded simulator: towns on highway-env's roads and kinematics, traffic in arrays, drawn cameras."""
