"""Checks of a simulator plugin: its maps and weather, its rig and the environments that it makes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from typing import Any, get_type_hints

import numpy as np

from me3bev_cli.api import (
    ACTOR_KINDS,
    BEV_CLASSES,
    NAVIGATION_WIDTH,
    ROAD_WIDTH,
    VEHICLE_WIDTH,
    ObservationConfig,
    PluginConfig,
    StepRecord,
)
from me3bev_cli.errors import UserError
from me3bev_cli.evaluation.episode import COLLISIONS, CONTACTS
from me3bev_cli.testing import require

STEPS = 5
DRAWS = 16
PLAN_SIZES = (64, 150)
DEFAULT_WEATHER = "info['weather'] is the first of weathers() where none was asked for"
VECTORS = {"road": ROAD_WIDTH, "vehicle": VEHICLE_WIDTH, "navigation": NAVIGATION_WIDTH}


def check_simulator(cls: Any, config: PluginConfig, observation: ObservationConfig, seed: int) -> None:
    """All of it, on the first map at the first density."""
    simulator = cls(config)
    for name in ("maps", "densities", "weathers"):
        listed = getattr(simulator, name)()
        fits = isinstance(listed, tuple) and len(listed) > 0 and all(isinstance(word, str) for word in listed)
        require(cls, fits, f"{name}() gives a tuple of names that is not empty", listed)
    _check_rig(cls, simulator, observation)
    place = {"map": simulator.maps()[0], "density": simulator.densities()[0]}
    with closing(simulator.make_env(observation, **place)) as env:
        first = _check_episode(cls, env, observation, seed)
        _check_extras(cls, env)
    _check_repeats(cls, simulator, observation, place, seed, first)
    _check_blind(cls, simulator, observation, place, seed)
    _check_weather(cls, simulator, observation, place, seed, first)


def _check_rig(cls: Any, simulator: Any, observation: ObservationConfig) -> None:
    rig = simulator.rig(observation)
    names = tuple(camera.name for camera in rig.cameras)
    require(cls, names == observation.cameras, "the rig has the cameras asked for, in order", names)
    size = (observation.height, observation.width)
    require(cls, rig.image_size == size, "the rig's images have the size asked for", rig.image_size)
    try:
        simulator.rig(observation.model_copy(update={"cameras": ("no_such_camera",)}))
    except (ValueError, UserError):
        return
    require(cls, False, "an unknown camera raises ValueError", "it was accepted")


def _check_episode(cls: Any, env: Any, observation: ObservationConfig, seed: int) -> dict[str, Any]:
    """The first observation, after a few steps whose every part is checked."""
    image = (len(observation.cameras), 3, observation.height, observation.width)
    spaces = env.observation_space.spaces
    shapes = {name: space.shape for name, space in spaces.items()}
    promised = {"images": image, **{name: (width,) for name, width in VECTORS.items()}}
    require(cls, shapes == promised, f"the observation's shapes are {promised}", shapes)
    require(cls, spaces["images"].dtype == np.uint8, "images are uint8", spaces["images"].dtype)
    require(cls, env.action_space.shape == (2,), "an action is (steering, longitudinal)", env.action_space)
    bounds = np.stack([env.action_space.low, env.action_space.high])
    require(cls, bool((np.abs(bounds) == 1).all()), "actions lie in [-1, 1]", bounds.tolist())
    first, _ = env.reset(seed=seed)
    first = {name: np.array(value) for name, value in first.items()}
    require(cls, env.observation_space.contains(first), "the first observation lies in the space", shapes)
    rng = np.random.default_rng(seed)
    for _ in range(STEPS):
        action = rng.uniform(-1, 1, 2).astype(env.action_space.dtype)
        obs, reward, terminated, truncated, info = env.step(action)
        require(cls, env.observation_space.contains(obs), "every observation lies in the space", "one does not")
        require(cls, bool(np.isfinite(float(reward))), "the reward is a finite number", reward)
        _check_record(cls, info)
        if terminated or truncated:
            env.reset(seed=seed + 1)
    return first


def _check_record(cls: Any, info: dict[str, Any]) -> None:
    record = info.get("record")
    require(cls, isinstance(record, dict), "info['record'] is a StepRecord", record)
    missing = sorted(set(StepRecord.__annotations__) - set(record or {}))
    require(cls, not missing, "the record has every key of StepRecord", f"missing: {', '.join(missing)}")
    for name, kind in get_type_hints(StepRecord).items():
        value = (record or {})[name]
        fits = (
            isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if kind is float
            else isinstance(value, kind)
        )
        require(cls, fits, f"the record's `{name}` is a {kind.__name__}", repr(value))
        finite = kind is not float or name in ("traffic_speed", "background_speed") or bool(np.isfinite(value))
        require(cls, finite, f"the record's `{name}` is finite", value)
    said = (record or {})["collision"], (record or {})["contact"]
    known = said[0] in COLLISIONS and said[1] in CONTACTS and bool(said[0]) == bool(said[1])
    require(cls, known, f"`collision` is one of {COLLISIONS} and, with it, `contact` one of {CONTACTS}", said)


def _check_extras(cls: Any, env: Any) -> None:
    action = np.asarray(env.unwrapped.autopilot())
    inside = action.shape == (2,) and bool((np.abs(action) <= 1).all())
    require(cls, inside, "autopilot() gives an action in [-1, 1]", action)
    classes = env.unwrapped.bev_semantics()
    fits = classes.shape == (200, 200) and classes.dtype == np.uint8 and int(classes.max()) < len(BEV_CLASSES)
    require(cls, fits, "bev_semantics() is (200, 200) uint8 of known classes", (classes.shape, classes.dtype))
    _check_others(cls, env)
    _check_camera_truth(cls, env)
    for size in PLAN_SIZES:
        plan = env.unwrapped.plan_view(size)
        fits = plan.shape == (size, size, 3) and plan.dtype == np.uint8
        require(cls, fits, f"plan_view({size}) is ({size}, {size}, 3) uint8", (plan.shape, plan.dtype))


def _check_others(cls: Any, env: Any) -> None:
    """The methods that an environment may leave out."""
    world = env.unwrapped
    if hasattr(world, "actors"):
        boxes, kinds, speeds = world.actors()
        fits = boxes.shape == (len(boxes), 7) and kinds.shape == speeds.shape == (len(boxes),)
        require(cls, fits, "actors() gives boxes (A, 7), kinds (A,) and speeds (A,)", (boxes.shape, kinds.shape))
        known = bool(((kinds >= 0) & (kinds < len(ACTOR_KINDS))).all()) and bool(np.isfinite(boxes).all())
        require(cls, known, f"the kinds of actors are indices of {ACTOR_KINDS}, their boxes finite", kinds)
    if hasattr(world, "route_line"):
        line = world.route_line()
        fits = line.ndim == 2 and line.shape[1] == 3 and bool(np.isfinite(line).all())
        require(cls, fits, "route_line() is (P, 3), finite", line.shape)


def _check_camera_truth(cls: Any, env: Any) -> None:
    cameras, _, height, width = env.observation_space.spaces["images"].shape
    depth, classes = env.unwrapped.camera_truth()
    shapes = tuple(part.shape for part in (depth, classes))
    promised = (cameras, height, width)
    require(cls, shapes == (promised, promised), f"camera_truth() is depth and classes, each {promised}", shapes)
    kinds = (depth.dtype, classes.dtype)
    require(cls, kinds == (np.float32, np.uint8), "camera_truth() is float32 and uint8", kinds)
    require(cls, bool((depth > 0).all()), "every depth is positive, inf where nothing is", float(depth.min()))
    require(cls, int(classes.max()) < len(BEV_CLASSES), "every pixel is of a known class", int(classes.max()))
    if hasattr(env.unwrapped, "look_from"):
        here = env.unwrapped.look_from(0.0, 0.0, 0.0, 1.0)
        told = (depth, classes, env.unwrapped.bev_semantics())
        same = all(np.array_equal(part, other) for part, other in zip(here[1:], told, strict=True))
        require(cls, same, "look_from(0, 0, 0, 1) gives the truth of where the ego is", "it differs")


def _check_weather(
    cls: Any, simulator: Any, observation: ObservationConfig, place: dict[str, str], seed: int, first: dict[str, Any]
) -> None:
    """Each kind by name, the default one, and a draw from all of them."""
    names = simulator.weathers()
    for name in (None, *names):
        weather = None if name is None else (name,)
        with closing(simulator.make_env(observation, **place, weather=weather, images=False)) as env:
            vectors, info = env.reset(seed=seed)
            promise = f"info['weather'] is '{name}' where that was asked for" if name else DEFAULT_WEATHER
            wanted = name or names[0]
            require(cls, info.get("weather") == wanted, f"{promise}, at reset", info.get("weather"))
            same = all(np.array_equal(vectors[key], first[key]) for key in VECTORS)
            require(cls, same, "routes and traffic of a seed are the same in any weather", f"not in '{wanted}'")
            *_, info = env.step(np.zeros(2, env.action_space.dtype))
            require(cls, info.get("weather") == wanted, f"{promise}, at every step", info.get("weather"))
    drawn = [_drawn(simulator, observation, place, names, seed) for _ in range(2)]
    require(cls, drawn[0] == drawn[1], "an episode's seed decides its weather", drawn)
    alone = len(names) == 1
    require(cls, alone or len(set(drawn[0])) > 1, "an episode draws one of the kinds of weather asked for", drawn[0])
    try:
        simulator.make_env(observation, **place, weather=("no_such_weather",), images=False).close()
    except (ValueError, UserError):
        return
    require(cls, False, "an unknown weather raises UserError", "it was accepted")


def _drawn(
    simulator: Any, observation: ObservationConfig, place: dict[str, str], weather: Sequence[str], seed: int
) -> list[str]:
    """The weather of some episodes in a row."""
    with closing(simulator.make_env(observation, **place, weather=weather, images=False)) as env:
        return [env.reset(seed=seed + index)[1].get("weather") for index in range(DRAWS)]


def _check_repeats(
    cls: Any, simulator: Any, observation: ObservationConfig, place: dict[str, str], seed: int, first: dict[str, Any]
) -> None:
    with closing(simulator.make_env(observation, **place)) as env:
        again, _ = env.reset(seed=seed)
        for name, value in first.items():
            same = np.array_equal(value, again[name])
            require(cls, same, "the same seed gives the same first observation", f"`{name}` differs")
        other, _ = env.reset(seed=seed + 1)
        differs = any(not np.array_equal(value, other[name]) for name, value in first.items())
        require(cls, differs, "another seed gives another episode", "the first observation is the same")


def _check_blind(cls: Any, simulator: Any, observation: ObservationConfig, place: dict[str, str], seed: int) -> None:
    with closing(simulator.make_env(observation, **place, images=False)) as env:
        obs, _ = env.reset(seed=seed)
        require(cls, set(obs) == set(VECTORS), "with images=False an observation has no images", sorted(obs))
