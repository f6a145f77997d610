"""The batch: results that do not depend on other environments, its contract, and the largest possible reward."""

import copy
import tracemalloc
from dataclasses import replace

import numba
import numpy as np
import pytest

from eia_sec.common.config import CameraConfig, FarmConfig, RadioConfig, RelayConfig, StressConfig, WorldConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import SimulationError
from eia_sec.common.seeds import derive, stream
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.core import compile as decorators
from eia_sec.rollout.sim.core.compile import allocation_free, compiled_entry, sources_digest
from eia_sec.rollout.sim.core.radio import draw
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.reference.farm import ReferenceFarm, packet_draw
from eia_sec.rollout.sim.start import start_positions
from tests.constants import with_constants

SHORT = replace(preset("eia-sec").farm, world=WorldConfig(steps=40, start_levels="random"))
PLANNING = replace(SHORT, observation=replace(SHORT.observation, plan=6))
"""The same with plans, which have lists of their own for every environment and memory of their own for every thread."""
ARRAYS = (
    "observation",
    "reward",
    "parts",
    "position",
    "aoi",
    "vdf",
    "assignment",
    "energy",
    "utility",
    "served_sensors",
    "link_quality",
)


def fly(
    config: FarmConfig, episodes: list[tuple[int, int]], steps: int, threads: int = 1
) -> list[dict[str, np.ndarray]]:
    """Fly the episodes as one batch, each with actions that follow from its seeds; return what each looked like."""
    batch = FarmBatch(config, len(episodes), threads)
    action = np.empty((steps, len(episodes), batch.team.environment_action_size), np.float32)
    for index, (farm, episode) in enumerate(episodes):
        batch.reset(index, farm, episode)
        action[:, index] = np.random.default_rng((farm, episode)).uniform(
            -1.0, 1.0, (steps, batch.team.environment_action_size)
        )
    course = {name: [getattr(batch, name).copy()] for name in ARRAYS}
    for step in range(steps):
        batch.step(action[step])
        for name in ARRAYS:
            course[name].append(getattr(batch, name).copy())
    stacked = {name: np.stack(values) for name, values in course.items()}
    return [{name: values[:, index] for name, values in stacked.items()} for index in range(len(episodes))]


def test_an_episode_is_bit_equal_alone_in_company_and_twice():
    """The same (farm seed, episode seed) alone, twice, and among 256 in shuffled order."""
    episodes = [(farm, episode) for farm in range(16) for episode in range(16)]
    order = np.random.default_rng(0).permutation(256)
    crowd = dict(zip([episodes[k] for k in order], fly(SHORT, [episodes[k] for k in order], 40), strict=True))
    for chosen in [(0, 0), (7, 3), (15, 15)]:
        alone, again = fly(SHORT, [chosen], 40)[0], fly(SHORT, [chosen], 40)[0]
        for name in ARRAYS:
            np.testing.assert_array_equal(alone[name], again[name])
            np.testing.assert_array_equal(alone[name], crowd[chosen][name])


@pytest.mark.parametrize(("config", "threads"), [(SHORT, 2), (SHORT, 3), (SHORT, 9), (PLANNING, 3)])
def test_results_do_not_depend_on_the_number_of_threads(config, threads):
    """Seven environments on one thread, on two, on three, and on more threads than there are environments."""
    episodes = [(farm, 1) for farm in range(7)]
    for alone, together in zip(fly(config, episodes, 40), fly(config, episodes, 40, threads), strict=True):
        for name in ARRAYS:
            np.testing.assert_array_equal(alone[name], together[name])


def test_a_copy_looks_at_its_own_areas():
    """How fast counters rise is that of the farm that the copy flies, wherever it was copied."""
    area = (3, ((0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0)))
    batch = FarmBatch(replace(SHORT, stress=StressConfig(areas=(area,))), 1)
    twin = copy.deepcopy(batch)
    for farms in (batch, twin):
        farms.reset(0, 0, 5)
    assert sorted(set(twin.plot_growth.ravel().tolist())) == [1, 3]
    np.testing.assert_array_equal(twin.sensor_growth, batch.sensor_growth)


@pytest.mark.parametrize(("config", "threads"), [(SHORT, 1), (SHORT, 2), (PLANNING, 2)])
def test_a_deep_copy_goes_on_as_the_original_would(config, threads):
    """A copy takes the same steps to the same end, and neither changes the other."""
    batch = FarmBatch(config, 3, threads)
    for e in range(3):
        batch.reset(e, e, 5)
    random = np.random.default_rng(0)
    actions = random.uniform(-1, 1, (8, 3, batch.team.environment_action_size)).astype(np.float32)
    batch.step(actions[0])
    twin = copy.deepcopy(batch)
    seen = batch.observation.copy()
    for action in actions[1:]:
        twin.step(action)
    np.testing.assert_array_equal(batch.observation, seen)
    for action in actions[1:]:
        batch.step(action)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(batch, name), getattr(twin, name), err_msg=name)
    assert batch.summary(1) == twin.summary(1)


def test_threads_refuse_impossible_actions_before_any_environment_moves():
    """One bad number in the last thread's share stops the first thread too."""
    batch = FarmBatch(SHORT, 4, threads=2)
    for index in range(4):
        batch.reset(index, index, 0)
    before = batch.position.copy()
    action = np.ones((4, 24), np.float32)
    action[3, 23] = np.nan
    with pytest.raises(SimulationError):
        batch.step(action)
    np.testing.assert_array_equal(batch.position, before)
    assert (batch.time == 0).all()


def test_a_step_keeps_no_memory():
    """Neither Python nor the compiler's runtime allocates anything that grows over steps, in any number of them."""
    batch = FarmBatch(SHORT, 3)
    for index in range(3):
        batch.reset(index, index, 0)
    action = np.full((3, 24), 0.5, np.float32)
    batch.step(action)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        for _ in range(30):
            batch.step(action)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 512
    assert peak - before < 2048


def test_what_allocates_does_not_compile():
    """The kernel's functions are compiled without the allocating runtime, so an array made in a step is refused."""

    @allocation_free
    def allocate(count: int) -> float:
        return np.zeros(count)[0]

    with pytest.raises(numba.errors.NumbaError):
        allocate(3)


def test_machine_code_is_compiled_anew_when_a_source_changes(monkeypatch):
    """The key of an entry's machine code on disk holds the digest of all kernel sources, as they were at its import."""

    def twice(number: int) -> int:
        return 2 * number

    entry = compiled_entry(twice)
    assert entry(3) == 6
    codegen = numba.core.registry.cpu_target.target_context.codegen()
    signature, digest = entry.signatures[0], sources_digest()
    before = entry._cache._index_key(signature, codegen)
    assert digest in before
    monkeypatch.setattr(decorators, "sources_digest", lambda: "another")
    assert entry._cache._index_key(signature, codegen) == before
    after = compiled_entry(twice)._cache._index_key(signature, codegen)
    assert "another" in after
    assert digest not in after


def test_actions_may_be_read_only_and_strided():
    """The same step as with an array of one's own."""
    batches = [FarmBatch(SHORT, 2) for _ in range(2)]
    action = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 24)).astype(np.float32)
    strided = np.repeat(action, 2, axis=1)[:, ::2]
    strided.setflags(write=False)
    for batch, given in zip(batches, (action, strided), strict=True):
        for index in range(2):
            batch.reset(index, index, 0)
        batch.step(given)
    np.testing.assert_array_equal(batches[0].observation, batches[1].observation)


def test_other_seeds_are_other_episodes():
    """Farm and episode seed both matter, to where UAVs start and to which packets arrive."""
    starts = [start_positions(SHORT.world, farm, episode) for farm, episode in [(0, 0), (0, 1), (1, 0)]]
    assert not np.array_equal(starts[0], starts[1])
    assert not np.array_equal(starts[0], starts[2])


def test_packets_are_drawn_alike_in_kernel_and_reference():
    """Both compute the same splitmix64 numbers, which are uniform and unrelated between steps and sensors."""
    key = 0x7123456789ABCDEF
    ours = np.array([[draw(np.uint64(key), step, sensor) for sensor in range(60)] for step in range(1, 61)])
    theirs = np.array([[packet_draw(key, step, sensor) for sensor in range(60)] for step in range(1, 61)])
    np.testing.assert_array_equal(ours, theirs)
    assert ours.mean() == pytest.approx(0.5, abs=0.02)
    assert np.histogram(ours, 10, (0.0, 1.0))[0] == pytest.approx(360, abs=80)
    assert abs(np.corrcoef(ours[1:].ravel(), ours[:-1].ravel())[0, 1]) < 0.06
    assert abs(np.corrcoef(ours[:, 1:].ravel(), ours[:, :-1].ravel())[0, 1]) < 0.06


def test_deliveries_follow_the_packet_loss():
    """Over many episodes the credits are in the mean what the chances of the packets in the air add up to."""
    config = replace(
        SHORT, world=replace(SHORT.world, steps=1), radio=with_constants(RadioConfig(), sensor_power_dbm=5.0)
    )
    credit, expected = np.zeros(300), np.zeros(300)
    batch = FarmBatch(config, 1)
    for index in range(300):
        batch.reset(0, 0, index)
        farm = ReferenceFarm(config, make_layout(config, 0), index)
        held = farm.aoi.copy()
        action = np.zeros((1, 24), np.float32)
        batch.step(action)
        farm.step(action[0], batch.assignment[0])
        credit[index], expected[index] = batch.utility[0, 8:].sum(), (farm.chance * held).sum()
    deviation = (credit - expected).std() / np.sqrt(300)
    assert 0.0 < deviation < 0.5
    assert abs((credit - expected).mean()) < 4.0 * deviation


def test_uavs_start_a_safe_distance_apart_in_their_plane():
    """At least d_safety in one plane, and inside the field; an overcrowded plane still finds places."""
    world = WorldConfig()
    place = start_positions(world, 3, 4)
    assert ((place >= 0.0) & (place <= 400.0)).all()
    for plane in (place[:4], place[4:8], place[8:]):
        apart = np.linalg.norm(plane[:, None] - plane, axis=2) + np.eye(4) * 1e9
        assert apart.min() >= world.safety_distance
    crowded = start_positions(WorldConfig(field_x=60.0, field_y=60.0, communication_uavs=64), 0, 0)
    assert np.isfinite(crowded).all()


def test_start_positions_are_drawn_one_after_the_other():
    """Each is the next of the episode's stream that is in no zone and keeps its distance within its plane."""
    square, corner = np.array([[100.0, 100.0], [300.0, 100.0], [300.0, 300.0], [100.0, 300.0]]), np.zeros((3, 2))
    corner[1, 0] = corner[2, 1] = 90.0
    world = WorldConfig(communication_uavs=16, monitoring_uavs=16, collection_uavs=16)
    random, wanted, refused = stream(5, 6, "start"), [], 0
    for _ in range(3):
        plane = []
        while len(plane) < 16:
            x, y = random.random() * 400.0, random.random() * 400.0
            taken = max(abs(x - 200.0), abs(y - 200.0)) <= 100.0 or x + y <= 90.0
            refused += taken
            if not taken and all(np.hypot(x - a, y - b) >= world.safety_distance for a, b in plane):
                plane.append((x, y))
        wanted += plane
    assert refused > 5
    np.testing.assert_array_equal(start_positions(world, 5, 6, (square, corner)), wanted)


def test_the_supply_of_an_episode_bounds_what_is_credited():
    """UAVs that serve everything except when counters rise get 6400 units of VDF and, but for the last, 4000 of AoI."""
    everything = FarmConfig(
        radio=with_constants(RadioConfig(), sensor_power_dbm=90.0),
        camera=with_constants(CameraConfig(), image_distance=1000.0, plot_threshold=1.0),
        relay=RelayConfig(require_link=True, capacity=8),
    )
    batch = FarmBatch(everything, 1)
    batch.reset(0, 0, 0)
    batch.position[:, 4:] = 200.0
    vdf = aoi = 0.0
    for step in range(1, 501):
        batch.position[:, :4] = 0.0 if step % 10 == 0 else 200.0
        batch.step(np.zeros((1, 24), np.float32))
        vdf += batch.utility[0, 4:8].sum()
        aoi += batch.utility[0, 8:].sum()
    cycle = batch.layout(0).sensor_cycle_steps
    assert vdf == 6400.0
    assert aoi == (499 // cycle).sum()
    assert aoi + batch.aoi.sum() == (500 // cycle).sum() == pytest.approx(4000.0, abs=20.0)


def test_a_counter_that_is_served_while_it_rises_pays_nothing():
    """Read literally, delivery takes precedence over the rise, so permanent service never earns a unit."""
    everything = FarmConfig(camera=with_constants(CameraConfig(), image_distance=1000.0, plot_threshold=1.0))
    batch = FarmBatch(everything, 1)
    batch.reset(0, 0, 0)
    for _ in range(100):
        batch.step(np.zeros((1, 24), np.float32))
        assert not batch.vdf.any()
        assert not batch.utility[0, 4:8].any()


def test_counters_rise_with_their_cycles_and_stop_at_their_caps():
    """Where nobody collects, AoI is floor(t / cycle) and VDF floor(t / 30), both at most 5."""
    nothing = FarmConfig(
        radio=with_constants(RadioConfig(), sensor_power_dbm=-100.0),
        camera=with_constants(CameraConfig(), image_distance=1.0),
    )
    batch = FarmBatch(nothing, 1)
    batch.reset(0, 0, 0)
    cycle = batch.layout(0).sensor_cycle_steps
    for step in range(1, 401):
        batch.step(np.zeros((1, 24), np.float32))
        np.testing.assert_array_equal(batch.aoi[0], np.minimum(step // cycle, 5))
        assert (batch.vdf[0] == min(step // 30, 5)).all()


def test_the_episode_ends_once_and_nothing_goes_on_by_itself():
    """The flag turns true at the last step; a further step is refused, and so is one before a reset."""
    batch = FarmBatch(SHORT, 2)
    still = np.zeros((2, 24), np.float32)
    with pytest.raises(SimulationError):
        batch.step(still)
    with pytest.raises(SimulationError):
        batch.summary(0)
    with pytest.raises(SimulationError):
        batch.layout(1)
    for index in range(2):
        batch.reset(index, index, 0)
    for step in range(40):
        assert not batch.truncated.any()
        assert (batch.time == step).all()
        batch.step(still)
    assert batch.truncated.all()
    with pytest.raises(SimulationError):
        batch.step(still)
    batch.reset(0, 1, 1)
    assert batch.truncated.tolist() == [False, True]


@pytest.mark.parametrize(
    "action",
    [
        np.zeros((2, 24), np.float64),
        np.zeros((1, 24), np.float32),
        np.zeros((2, 23), np.float32),
        np.full((2, 24), np.nan, np.float32),
        np.full((2, 24), np.inf, np.float32),
    ],
)
def test_impossible_actions_are_refused_and_change_nothing(action):
    """Other types, shapes and numbers that are not finite."""
    batch = FarmBatch(SHORT, 2)
    for index in range(2):
        batch.reset(index, index, 0)
    before = batch.position.copy()
    with pytest.raises(SimulationError):
        batch.step(action)
    np.testing.assert_array_equal(batch.position, before)
    assert (batch.time == 0).all()


def test_an_empty_batch_is_refused():
    """A batch needs an environment and a thread."""
    with pytest.raises(SimulationError):
        FarmBatch(SHORT, 0)
    with pytest.raises(SimulationError):
        FarmBatch(SHORT, 1, threads=0)


def test_observations_stay_in_bounds():
    """Over random flights every observed number lies in [-1, 1] or close to it, and is finite."""
    course = fly(SHORT, [(farm, 0) for farm in range(8)], 40)
    for episode in course:
        assert np.isfinite(episode["observation"]).all()
        assert np.abs(episode["observation"]).max() <= 1.01


def test_seeds_of_numpy_are_numbers_like_others():
    """A farm does not depend on the type of the number that names it."""
    assert derive(np.int64(1000), "a") == derive(1000, "a") != derive("1000", "a")
    with pytest.raises(TypeError):
        derive(1000.0)


def test_packed_arguments_are_packed_anew_wherever_they_are_rebuilt():
    """Addresses do not travel with an environment that a user's wrapper serialises."""
    (packed,) = FarmBatch(SHORT, 1)._arguments
    again = copy.copy(packed)  # asks for what serialisers ask for
    assert again.workspace is packed.workspace
    assert again.address != packed.address
