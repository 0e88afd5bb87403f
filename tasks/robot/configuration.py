"""Settings of the robot stage: the cart, how it plans, what it measures, and what goes wrong with all of that."""

from __future__ import annotations

import dataclasses
from typing import Literal, Self

from pydantic import model_validator

from tasks.settings import Config, Count, Natural, NonNegative, Positive, Share

Senses = Literal["wheels", "wheels_gyro", "all"]
"""What takes part in saying where a cart is; all: encoders, gyro and lidar."""


@dataclasses.dataclass(frozen=True)
class Cart(Config):
    """A differential drive: two driven wheels on one axle, casters before and behind. Its shape is an upright cylinder around the axle."""

    radius_m: Positive = 0.17  # a service cart that goes wherever the episodes' agent of 0.18 m can
    height_m: Positive = 0.25  # under chairs and beds that let it through; its lidar sees nearly all of what it could run into
    climb_m: NonNegative = 0.02  # sills and cables; a wheel of 10 cm climbs a fifth of its diameter
    covering_m: NonNegative = 0.06  # rugs and mats of this thickness are driven over: their edges give way, and scans thicken them
    wheel_radius_m: Positive = 0.05  # wheels of 10 cm, as carts of this size have them
    track_m: Positive = 0.26  # between the wheels' middles: they lie inside the outline
    mass_kg: Positive = 12.0  # battery, two motors, computer
    speed_mps: Positive = 0.5  # walking slowly: indoor carts near people go no faster
    reverse_mps: NonNegative = 0.15  # backward is for getting out; nothing is in view there but the lidar's plane
    turn_rps: Positive = 1.0  # a turn of 30 degrees in half a second, the paper's action
    acceleration_mps2: Positive = 0.5  # stands from full speed within 0.25 m; what is loaded stays on it
    turn_acceleration_rps2: Positive = 2.0  # full turn rate within half a second


@dataclasses.dataclass(frozen=True)
class Planner(Config):
    """Sub-goals and the dynamic window (Fox, Burgard and Thrun 1997)."""

    period_s: Positive = 0.1  # 10 decisions a second, as often as the lidar turns
    spacing_m: Positive = 0.5  # supplementary B.3: a sub-goal every half metre
    advance_m: Positive = 0.25  # half a spacing: the next one comes up before this one slows the cart down
    margin_m: NonNegative = 0.05  # kept beside the cart's radius: estimate, latency and lidar together err by less
    snap_m: Positive = 0.2  # a way's end may move so far to where the cart fits; farther is another place
    arrive_m: Positive = 0.15  # half of a body's width off the end of its way, it is there
    horizon_s: Positive = 2.0  # 1 m at full speed, twice what braking takes
    speeds: Count = 11  # of the window: steps of 1 cm/s while accelerating
    turns: Count = 21  # of the window: steps of 0.02 rad/s
    heading_weight: NonNegative = 0.8  # angle to the sub-goal at the arc's end [per pi rad]
    distance_weight: NonNegative = 0.4  # how much nearer the arc comes, of what it could
    speed_weight: NonNegative = 0.2  # among arcs that lead there, the fast one
    clearance_weight: NonNegative = 0.1  # passes in the middle where that costs little
    clear_m: Positive = 1.0  # more clearance than this is worth nothing
    slow_m: Positive = 0.4  # sub-goals nearer than this are approached in proportion: they are half a metre apart
    stuck_s: Positive = 2.0  # without progress for so long the cart recovers
    back_up_m: Positive = 0.2  # a radius: enough to turn beside what was before it
    recoveries: Natural = 6  # of turning, backing up and planning anew; then the run is given up


@dataclasses.dataclass(frozen=True)
class Lidar(Config):
    """A laser that turns in one plane, over the axle."""

    rays: Count = 360  # one a degree, as carts' lidars have
    height_m: Positive = 0.1  # over rugs; low, since what is lower is not seen: feet of chairs, toys
    least_m: NonNegative = 0.1  # nearer returns are the cart itself
    range_m: Positive = 12.0  # of small lidars; rooms are smaller
    noise_m: NonNegative = 0.01  # of a return, standard deviation
    dropped: Share = 0.01  # of returns, lost on dark and shiny things
    period_s: Positive = 0.1  # ten turns a second
    latency_s: NonNegative = 0.15  # until a scan is there: it is for a moment past


@dataclasses.dataclass(frozen=True)
class DriveNoise(Config):
    """What goes wrong between command and motion, and between motion and measurement."""

    slip: Share = 0.03  # of a wheel's speed, drawn for each wheel and run: carpet, a worn tire
    slip_walk: Share = 0.01  # of a wheel's speed, what that changes by in a second (standard deviation)
    skid_s: NonNegative = 0.005  # drawn for each run: sideways creep in curves, per speed and turn rate (standard deviation)
    delay_s: NonNegative = 0.1  # from a command until motors hear of it
    lag_s: NonNegative = 0.1  # time constant of the motors
    encoder: NonNegative = 0.01  # of a wheel's speed, noise of a reading
    gyro_noise_rps: NonNegative = 0.005  # of a reading
    gyro_bias_rps: NonNegative = 0.01  # drawn for each run (standard deviation)
    gyro_period_s: Positive = 0.02  # 50 readings a second
    encoder_period_s: Positive = 0.05  # 20 readings a second
    start_m: NonNegative = 0.02  # how well the start is known (standard deviation)
    start_radians: NonNegative = 0.02  # how well the heading at the start is known (standard deviation)


@dataclasses.dataclass(frozen=True)
class Estimation(Config):
    """What the filter takes part in, and what it believes of its measurements."""

    senses: Senses = "all"  # the fewer are for comparison
    gate: Share = 0.99  # of true measurements that pass; the rest are taken for wrong
    buffer_s: Positive = 1.0  # how late a measurement may be and still be put in its place
    slip_sigmas: Positive = 3.0  # wheels and gyro farther apart than this: the wheels slip, and count less
    map_sigma_m: Positive = 0.002  # how true the map is, beside the lidar's own noise
    match_steps: Count = 20  # of aligning a scan; most take five
    match_reach_m: Positive = 0.3  # returns farther from the map than this see what the map does not have
    match_share: Share = 0.3  # of returns that must lie on the map, or the scan says nothing


@dataclasses.dataclass(frozen=True)
class Displacement(Config):
    """Things that were moved since the scan: they stand elsewhere than the map says."""

    share: Share = 0.0  # of the small furniture on the floor
    largest_m: Positive = 1.0  # of a side seen from above: what one person moves
    reach_m: Positive = 1.0  # how far it is moved, at most
    turn_radians: NonNegative = 0.6  # how far it is turned, at most


@dataclasses.dataclass(frozen=True)
class RobotConfig(Config):
    """A cart in a replica."""

    cart: Cart = dataclasses.field(default_factory=Cart)
    planner: Planner = dataclasses.field(default_factory=Planner)
    lidar: Lidar = dataclasses.field(default_factory=Lidar)
    noise: DriveNoise = dataclasses.field(default_factory=DriveNoise)
    estimation: Estimation = dataclasses.field(default_factory=Estimation)
    displacement: Displacement = dataclasses.field(default_factory=Displacement)
    body: Literal["planar", "mujoco"] = "planar"  # mujoco: wheels that touch the floor of the exported scene; two to four times slower
    routes: Count = 10  # of a scene, spread over its episodes
    seconds: Positive = 180.0  # of simulated time; the longest ways of dwellings take 100
    substep_s: Positive = 0.01  # of the planar body: 5 mm at full speed
    record_s: Positive = 0.2  # between recorded poses

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.lidar.height_m > self.cart.height_m:
            raise ValueError(f"lidar.height_m: must be at most cart.height_m, {self.cart.height_m:g}, is {self.lidar.height_m:g}")
        if self.cart.track_m >= 2 * self.cart.radius_m:
            raise ValueError(f"cart.track_m: must be less than twice radius_m, {2 * self.cart.radius_m:g}, is {self.cart.track_m:g}")
        if self.cart.climb_m >= self.lidar.height_m:
            raise ValueError(f"cart.climb_m: must be below lidar.height_m, {self.lidar.height_m:g}, is {self.cart.climb_m:g}")
        return self


def unusual(config: RobotConfig) -> str:
    """What of a config is not as by default, in a line: `displacement.share 0.1, noise.slip 0.05`. The body has a column of its own, and
    how many ways are driven and how often they are recorded changes none of them."""
    usual = RobotConfig()
    plain = dataclasses.replace(config, body=usual.body, routes=usual.routes, record_s=usual.record_s)
    return ", ".join(_differences(plain, usual, ""))


def _differences(config: Config, usual: Config, path: str) -> list[str]:
    """Of one table of settings, and of those in it."""
    differing = []
    for field in dataclasses.fields(config):
        value, default = getattr(config, field.name), getattr(usual, field.name)
        if isinstance(value, Config):
            differing += _differences(value, default, f"{path}{field.name}.")
        elif value != default:
            differing.append(f"{path}{field.name} {value:g}" if isinstance(value, float) else f"{path}{field.name} {value}")
    return sorted(differing)
