"""What became of an episode, in a line."""

from __future__ import annotations

from me3bev_cli.driving.film import OUTCOMES
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.metrics import measure


def outcome_line(episode: Episode) -> str:
    """Where, how it ended, and the figures that say most."""
    found = measure(episode)
    place = f"{episode.map}, {episode.density}, {episode.weather}, episode {episode.index + 1}"
    end = OUTCOMES[episode.ended]
    if episode.ended == "collision":
        end += f" with a {episode['collision'][-1]}" + (", at fault" if episode["at_fault"][-1] else "")
    parts = [
        f"{place}: {end} after {episode['time'][-1]:.1f} s",
        f"route {100 * found['route_completion']:.0f} %",
        f"driving score {found['driving_score']:.1f}",
        f"return per step {found['return_per_step']:.2f}",
        f"mean speed {found['mean_speed']:.1f} m/s",
    ]
    for name, what in (("red_lights", "red light"), ("stop_signs", "stop sign")):
        count = int(found[name])
        if count:
            parts.append(f"{count} {what}{'s' if count > 1 else ''} run")
    return ", ".join(parts)
