"""What CARLA's client makes of one OpenDRIVE file: `python carla_oracle.py FILE.xodr OUT.npz`, by a python that has it.

Run in a process of its own: the client ends its process on some files. Lanes are named (road, section, lane).
Written, in our frame (y north; CARLA's points south):
    keys (L, 3): the driving lanes longer than a metre or so; points (P, 4): x, y, z of lane centres and the row of
    their lane in `keys`; links (S, 2): rows of a lane and of the next such lane that follows it.
"""

import sys

import carla
import numpy as np

SPACING = 0.5
"""Metres between centres."""
STEP = 0.02
"""Metres by which the end of a lane is approached, to find what follows."""
FARTHEST = 4.0
"""Metres that lie at most between the last centre of a lane and the first of the next: slivers of lanes."""


def key_of(waypoint):
    return waypoint.road_id, waypoint.section_id, waypoint.lane_id


def main(source, target):
    with open(source, encoding="utf-8") as file:
        world = carla.Map("oracle", file.read())
    found = {}
    for waypoint in world.generate_waypoints(SPACING):
        found.setdefault(key_of(waypoint), []).append(waypoint)
    keys = sorted(key for key, waypoints in found.items() if len(waypoints) > 2)
    number = {key: index for index, key in enumerate(keys)}
    points, links = [], set()
    for key in keys:
        for waypoint in found[key]:
            at = waypoint.transform.location
            points.append((at.x, -at.y, at.z, number[key]))
        # Negative lanes drive with s, positive ones against it.
        last = max(found[key], key=lambda waypoint: waypoint.s * -np.sign(waypoint.lane_id))
        links |= {(number[key], number[other]) for other in following(last, number)}
    np.savez(target, keys=np.array(keys), points=np.array(points), links=np.array(sorted(links)))


def following(last, number):
    """The next lanes of those numbered: go on in small steps, on every branch, until one is reached."""
    frontier, reached = [last], set()
    for _ in range(int(FARTHEST / STEP)):
        ahead = [waypoint for before in frontier for waypoint in before.next(STEP)]
        frontier = []
        for waypoint in ahead:
            key = key_of(waypoint)
            if key != key_of(last) and key in number:
                reached.add(key)
            else:
                frontier.append(waypoint)
        if not frontier:
            break
    return reached


if __name__ == "__main__":
    main(*sys.argv[1:])
