"""Fly a mission from Python: wait for the ring, let vehicle 2 hold and come back, and widen the ring.

python docs/examples/fly.py                 # case2 on bundled stubs, with its target near
python docs/examples/fly.py px4-trio        # vehicles, or their simulators, at the mission's urls
"""

import asyncio
import sys

import cordon


async def fly(mission, **how):
    async with cordon.fly(mission, **how) as flight:
        await flight.until("encircle", within_s=300.0)
        (answer,) = (await flight.command("hold", 2)).values()
        print(f"{flight.time_s:.1f} s: vehicle 2 {answer.did}")
        await flight.until(lambda: flight.vehicles[2].tactic == "hold", within_s=5.0)
        await flight.command("resume", 2)
        await flight.until("encircle", within_s=60.0)
        for vehicle, answer in (await flight.command("ring", radius=12.0)).items():
            print(f"{flight.time_s:.1f} s: vehicle {vehicle}: {answer.did}")
        result = await flight.complete()
    print(f"closest approach {result.closest_approach_m:.2f} m, log {flight.log}")
    return result


if __name__ == "__main__":
    if len(sys.argv) > 1:
        asyncio.run(fly(sys.argv[1]))
    else:
        near = cordon.load("case2", {"target.start_m": [12.0, 0.0]})
        asyncio.run(fly(near, stubs=True, speed=10.0, duration_s=120.0))
