"""From observation to action: sensor, assemble, policy, control, in flow order."""
