"""Tune the weights of the controller on the ring by Optuna, on plants drawn about the profile's.

Minimised are the distance from the place on the ring and the setpoint's unrest. A trial is pruned if another one was
better in both on the first plants. What was found is compared with the defaults on fresh plants.
"""

import argparse

import numpy as np
import optuna
from optuna.trial import TrialState

import cordon

RING = "tuning.encirclement."
DEFAULTS = {
    f"{RING}rate_weight": 10.0,
    f"{RING}spacing_weight": 24.0,
    f"{RING}radial_increment_weight": 0.2,
    f"{RING}angular_increment_weight": 2.0,
}
AT_ONCE = 8
SETTLED_S = 30.0
TUNED_SEED, FRESH_SEED = 0, 1_000_000

near = {"start_m": [12.0, 0.0], "velocity_m_s": [0.1, 0.0]}
mission = cordon.load("case2-field", {"target": near, "decision.distance_max_m": 20.0})


def family(draw):
    """Plants with stiffness and damping half to one and a half times those of the profile, and another delay."""
    plants = {}
    for vehicle in draw.mission.vehicles:
        a0, a1 = draw.random.uniform(0.5, 1.5, (2, 2)) * [vehicle.plant.a0_per_s2, vehicle.plant.a1_per_s]
        axes = (cordon.PlantAxis(*axis) for axis in np.transpose([a0, a1]).tolist())
        plants[vehicle.id] = cordon.Plant(*axes, delay_s=round(draw.random.uniform(0.0, 0.4), 2))
    return plants


def error_m(flight):
    """The distance from the place on the ring, rms: radius, and arc to the even spacing."""
    radius_m, late = flight.mission.encirclement.radius_m, flight.record.time_s > SETTLED_S
    vehicles = flight.vehicles.values()
    radial_m = np.array([each.radius_m[late] - radius_m for each in vehicles])
    arc_m = radius_m * np.array([each.lead_rad[late] - 2.0 * np.pi / len(vehicles) for each in vehicles])
    return np.sqrt(np.mean(radial_m**2 + arc_m**2))


def unrest_m_s(flight):
    """The change of the setpoint's velocity from tick to tick, rms."""
    late, rate_hz = flight.record.time_s > SETTLED_S, flight.mission.mission.rate_hz
    changes = [np.diff(each.setpoint_m[late, :2], 2, axis=0) * rate_hz for each in flight.vehicles.values()]
    return np.sqrt(np.mean(np.square(changes).sum(axis=-1)))


METRICS = {"error_m": error_m, "unrest_m_s": unrest_m_s}


def flown(settings, plants, seed):
    """Fly all settings on the same plants; return the metrics (settings, plants, 2), infinite where a flight failed."""
    table = cordon.sweep(
        mission, vary=settings, runs=plants, seed=seed, duration_s=70.0, plants=family, metrics=METRICS
    ).table
    values = np.array([table[name] for name in METRICS]).T.reshape(len(settings), plants, len(METRICS))
    return np.where(np.isnan(values), np.inf, values)


def tuned(trials, first, plants):
    """Return the study: its trials are told their means over all plants, or pruned after the first."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.TPESampler(seed=0, n_startup_trials=AT_ONCE, constant_liar=True)
    study = optuna.create_study(directions=["minimize"] * len(METRICS), sampler=sampler)
    study.enqueue_trial(DEFAULTS)
    first_means = []
    for begin in range(0, trials, AT_ONCE):
        asked = [study.ask() for _ in range(min(AT_ONCE, trials - begin))]
        settings = [
            {key: trial.suggest_float(key, 0.1 * value, 10.0 * value, log=True) for key, value in DEFAULTS.items()}
            for trial in asked
        ]
        early = flown(settings, first, TUNED_SEED)
        first_means += early.mean(axis=1).tolist()
        beaten = [(np.array(first_means) < mean).all(axis=1).any() for mean in early.mean(axis=1)]
        kept = [at for at, trial in enumerate(asked) if not beaten[at] or trial.number == 0]
        rest = flown([settings[at] for at in kept], plants - first, TUNED_SEED + 1) if kept else []
        for at, trial in enumerate(asked):
            if at in kept:
                study.tell(trial, np.concatenate([early[at], rest[kept.index(at)]]).mean(axis=0).tolist())
            else:
                study.tell(trial, state=TrialState.PRUNED)
        print(f"{len(study.trials)} trials, {len(study.get_trials(states=[TrialState.PRUNED]))} of them pruned")
    return study


def main(given):
    study = tuned(given.trials, given.first, given.plants)
    default = np.array(study.trials[0].values)
    front = sorted(study.best_trials, key=lambda trial: trial.values)
    balanced = min(front, key=lambda trial: max(trial.values / default))
    chosen = {"least error": front[0], "balanced": balanced, "calmest": front[-1]}
    found = {"defaults": DEFAULTS} | {name: trial.params for name, trial in chosen.items()}
    values = flown([*found.values()], given.fresh, FRESH_SEED)
    print(f"{'':12} {'error [m]: median, 95 %':>24} {'unrest [m/s]: median, 95 %':>27} {'lower than defaults':>20}")
    for name, settings, of_setting in zip(found, found.values(), values, strict=True):
        (error, unrest), (error_95, unrest_95) = np.quantile(of_setting, (0.5, 0.95), axis=0)
        better = " ".join(f"{share:8.0%}" for share in (of_setting < values[0]).mean(axis=0))
        weights = ", ".join(f"{key.removeprefix(RING)} {value:.3g}" for key, value in settings.items())
        print(f"{name:12} {error:15.3f} {error_95:8.3f} {unrest:18.3f} {unrest_95:8.3f} {better:>20}  {weights}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("--trials", type=int, default=48, help="settings to try")
    parser.add_argument("--first", type=int, default=4, help="plants after which a trial may be pruned")
    parser.add_argument("--plants", type=int, default=20, help="plants of a trial that is not pruned")
    parser.add_argument("--fresh", type=int, default=40, help="plants of the comparison")
    main(parser.parse_args())
