"""Vehicles leave a ring of five at random times: how close do the others come, and when is the ring even again?"""

import numpy as np

import cordon

team = [{"id": i, "profile": "stub-noisy", "start_m": [0.0, 12.0 - 4.0 * i]} for i in range(1, 6)]
target = {"start_m": [12.0, 0.0], "velocity_m_s": [0.0, 0.0]}
near = {"vehicles": team, "target": target, "formation.leader": 3, "decision.distance_max_m": 15.0}


def losses(draw):
    lost = draw.random.choice(draw.mission.ids, draw.values["draw.lost"], replace=False)
    return [cordon.Absent(vehicle, draw.random.uniform(35.0, 45.0)) for vehicle in lost]


def even_again_s(flight):
    vehicles, time_s = flight.vehicles.values(), flight.record.time_s
    lost_s = max(time_s[each.tactic == "unknown"][0] for each in vehicles if each.tactic[-1] == "unknown")
    leads_rad = np.array([each.lead_rad for each in vehicles if each.tactic[-1] != "unknown"])
    uneven = (np.abs(leads_rad - 2.0 * np.pi / len(leads_rad)) > np.radians(10.0)).any(axis=0)
    return time_s[uneven][-1] - lost_s if not uneven[-1] else None


mission = cordon.load("case2-field", near)
vary, metrics = {"draw.lost": [1, 2, 3]}, {"even_again_s": even_again_s}
found = cordon.sweep(mission, runs=200, vary=vary, duration_s=80.0, events=losses, metrics=metrics)
print(found.summary(by="draw.lost", metrics=["closest_approach_m", "even_again_s"]))
