"""An emulated radio against what its numbers say: transmission times, losses by Gilbert's model, order, one air."""

from math import inf, sqrt

import numpy as np
import pytest

from sitl.radio import Air, Channel, RadioSpec

FRAME = bytes(range(65))


def channel(seed: int = 0, **spec: object) -> Channel:
    radio = RadioSpec.model_validate(spec)
    return Channel(radio, Air(radio.bytes_s), (seed,))


def test_a_frame_takes_ten_bits_a_byte_and_the_latency() -> None:
    radio = channel(baud=57600, latency_ms=60.0)
    radio.send(FRAME, 1.0)
    radio.send(FRAME, 1.0)
    takes_s = len(FRAME) * 10 / 57600
    assert radio.arrives_s() == pytest.approx(1.0 + takes_s + 0.06)
    assert radio.arrived(1.0 + takes_s + 0.0601) == [FRAME]
    assert radio.arrives_s() == pytest.approx(1.0 + 2 * takes_s + 0.06)


def test_a_saturated_channel_carries_its_rate_and_drops_the_rest() -> None:
    radio, carried = channel(baud=38400, buffer_bytes=1000), 0
    for time_s in np.arange(0.0, 20.0, 0.005).tolist():
        radio.send(FRAME, time_s)
        carried += sum(len(frame) for frame in radio.arrived(time_s))
    assert carried == pytest.approx(20.0 * 3840.0, rel=0.01)
    assert radio.counts.dropped_frames == pytest.approx(4000 - 20.0 * 3840.0 / 65, rel=0.02)


def test_without_a_baud_frames_arrive_at_once() -> None:
    radio = channel()
    for _ in range(100):
        radio.send(FRAME, 5.0)
    assert radio.arrived(5.0) == [FRAME] * 100
    assert radio.arrives_s() == inf


@pytest.mark.parametrize(("loss", "burst"), [(0.02, None), (0.5, 10.0)])
def test_losses_have_the_share_and_the_rows_of_gilberts_model(loss: float, burst: float | None) -> None:
    radio, count = channel(seed=7, loss=loss, burst=burst), 40_000
    lost = np.zeros(count, dtype=bool)
    for index in range(count):
        before = radio.counts.lost_frames
        radio.send(b"x", float(index))
        radio.arrived(float(index))
        lost[index] = radio.counts.lost_frames > before
    row = 1.0 / (1.0 - loss) if burst is None else burst
    rows = np.count_nonzero(lost[1:] & ~lost[:-1]) + int(lost[0])
    # The states of this Markov chain are correlated by rho a step, which widens the variance p q / n of the mean.
    rho = 1.0 - 1.0 / row - loss / (1.0 - loss) / row
    deviation = sqrt(loss * (1.0 - loss) / count * (1.0 + rho) / (1.0 - rho))
    assert lost.mean() == pytest.approx(loss, abs=4.0 * deviation)
    # A row's length is geometric with the mean `row`.
    assert np.count_nonzero(lost) / rows == pytest.approx(row, abs=4.0 * sqrt(row * (row - 1.0) / rows) + 1e-9)


def test_frames_never_overtake_each_other_and_jitter_is_evenly_spread() -> None:
    radio, delays = channel(latency_ms=20.0, jitter_ms=100.0), list[float]()
    for index in range(2000):
        radio.send(index.to_bytes(4), 1.0 * index)
        delays.append(radio.arrives_s() - index)
        assert radio.arrived(1.0 * index + 0.13) == [index.to_bytes(4)]
    assert np.mean(delays) == pytest.approx(0.07, abs=4.0 * 0.1 / sqrt(12.0 * 2000))
    assert min(delays) >= 0.02
    for index in range(200):
        radio.send(index.to_bytes(4), 3000.0 + 0.001 * index)
    assert [int.from_bytes(frame) for frame in radio.arrived(4000.0)] == list(range(200))


def test_one_air_carries_its_rate_both_ways_together() -> None:
    spec = RadioSpec(baud=9600, shared=True)
    air = Air(spec.bytes_s)
    up, down = Channel(spec, air, (1,)), Channel(spec, air, (2,))
    carried = {"up": 0, "down": 0}
    for time_s in np.arange(0.0, 30.0, 0.02).tolist():
        for name, each in (("up", up), ("down", down)):
            each.send(FRAME, time_s)
            carried[name] += sum(len(frame) for frame in each.arrived(time_s))
    assert sum(carried.values()) == pytest.approx(30.0 * 960.0, rel=0.01)
    assert carried["up"] == pytest.approx(carried["down"], rel=0.1)


def test_noise_turns_one_bit_of_so_many_bytes() -> None:
    radio, turned = channel(seed=3, noise=0.01), np.zeros(0, np.uint8)
    for index in range(1000):
        radio.send(bytes(100), float(index))
        turned = np.append(turned, np.frombuffer(radio.arrived(float(index))[0], np.uint8))
    assert np.count_nonzero(turned) / turned.size == pytest.approx(0.01, abs=4.0 * sqrt(0.01 / turned.size))
    assert {int(byte).bit_count() for byte in turned} == {0, 1}
