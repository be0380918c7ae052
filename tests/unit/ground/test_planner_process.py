"""Tasks in separate processes: equal answers, errors as raised, killable, no orphans at any end of the owner."""

import contextlib
import math
import operator
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import CancelledError, wait
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from he3.errors import He3Error, InvalidInput, NoRoute
from he3.frames import SiteGrid
from he3.gp import Hyperparameters, fit_hyperparameters
from he3.kernels import Matern52
from services.ground.bounded_task import BoundedTask
from services.ground.planner_process import PlannerProcess
from services.ground.planners import PLANNERS, plan
from services.ground.planners.interface import PlannerOptions, PlanningRequest
from services.ground.planning import IGNORE_STD, run_planner
from services.ground.pure_tasks import MissionExecutor
from tests.waiting import PATIENCE_S, until


def request(seed=1, closed=False, size=120):
    mask = np.ones((size, size), dtype=bool)
    if closed:
        mask[3:8, 3:8] = False
        mask[5, 5] = True
    return PlanningRequest(
        grid=SiteGrid(size, size),
        traversable=mask,
        start_m=(5.2, 5.2),
        observed_m=np.array([[40.0, 40.0]]),
        std_ppb=np.random.default_rng(0).random(mask.shape).astype(np.float32),
        hyperparameters=Hyperparameters(Matern52(1.0, 30.0)),
        samples=5,
        samples_left=10,
        budget_m=math.inf,
        seed=seed,
    )


@pytest.fixture(scope="module")
def planners():
    with PlannerProcess() as process:
        yield process


def alive(pid):
    """Whether the process runs: neither gone nor a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def children_of(pid):
    with contextlib.suppress(OSError):
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return []


@pytest.mark.parametrize("name", ["rrt", "rrtstar", "informative"])
def test_a_plan_is_the_one_that_the_planner_makes_in_this_process(planners, name):
    futures = [planners.plan(name, request(seed)) for seed in (1, 2, 1)]
    first, second, third = (future.result(PATIENCE_S) for future in futures)
    here = plan(name, request(1))
    for there in (first, third):
        np.testing.assert_array_equal(there.path_m, here.path_m)
        np.testing.assert_array_equal(there.samples_m, here.samples_m)
        assert there.information_nats == here.information_nats
    assert not np.array_equal(first.path_m, second.path_m)


def test_a_refusal_is_raised_as_the_planner_raised_it(planners):
    with pytest.raises(NoRoute, match=r"5\.2"):
        planners.plan("rrtstar", request(closed=True)).result(PATIENCE_S)
    with pytest.raises(InvalidInput, match="seed of 0 or more, got -3"):
        planners.plan("rrt", request(seed=-3)).result(PATIENCE_S)


def test_an_unknown_planner_is_refused_at_once(planners):
    with pytest.raises(InvalidInput, match="'spiral'"):
        planners.plan("spiral", request())


def test_any_function_of_a_module_can_be_a_task(planners):
    assert planners.submit(operator.mul, 6, 7).result(PATIENCE_S) == 42
    rng = np.random.default_rng(3)
    places, values = rng.uniform(0, 100, (20, 2)), rng.normal(7, 1, 20)
    fit = partial(fit_hyperparameters, rng=np.random.default_rng(5))
    there = planners.submit(fit, places, values, "matern52").result(PATIENCE_S)
    assert there == fit_hyperparameters(places, values, "matern52", rng=np.random.default_rng(5))


def test_an_unexpected_error_says_where_it_happened(planners):
    with pytest.raises(ZeroDivisionError) as caught:
        planners.submit(operator.truediv, 1, 0).result(PATIENCE_S)
    assert any("in the planner process" in note for note in caught.value.__notes__)


def test_a_task_that_cannot_be_pickled_is_refused(planners):
    with pytest.raises(InvalidInput, match="pickled"):
        planners.submit(lambda: 1)


def test_an_answer_that_cannot_be_pickled_is_an_error_of_its_task_alone(planners):
    with pytest.raises(Exception, match="pickle"):
        planners.submit(threading.Lock).result(PATIENCE_S)
    assert planners.submit(operator.add, 1, 2).result(PATIENCE_S) == 3


def test_a_child_that_dies_is_reported_with_its_exit_status(planners):
    with pytest.raises(He3Error, match="exit status 3"):
        planners.submit(os._exit, 3).result(PATIENCE_S)
    with pytest.raises(He3Error, match="signal SIGABRT"):
        planners.submit(os.abort).result(PATIENCE_S)
    assert planners.submit(operator.add, 1, 2).result(PATIENCE_S) == 3


def test_a_large_task_and_a_large_answer_pass_each_other(planners):
    block = np.arange(3_000_000, dtype=np.float64)
    futures = [planners.submit(np.negative, block) for _ in range(6)]
    for future in futures:
        assert future.result(PATIENCE_S)[-1] == -block[-1]


def test_a_task_that_is_cancelled_is_killed_and_makes_room():
    with PlannerProcess(parallel=1) as process:
        endless = process.submit(time.sleep, 1000)
        behind = process.submit(operator.add, 1, 2)
        server = process._server.pid
        until(lambda: children_of(server), "the child to start")
        (child,) = children_of(server)
        assert endless.cancel()
        assert behind.result(PATIENCE_S) == 3
        until(lambda: not alive(child), "the child to die")
        with pytest.raises(CancelledError):
            endless.result(0)


def test_a_task_whose_time_is_up_is_ended_with_what_it_started_and_makes_room():
    with PlannerProcess(parallel=1) as process:
        began = time.monotonic()
        endless = process.submit(BoundedTask(subprocess.call, 1.0), ["sleep", "1000"])
        behind = process.submit(operator.add, 1, 2)
        server = process._server.pid
        until(lambda: children_of(server) and children_of(children_of(server)[0]), "the sleep to start")
        (child,) = children_of(server)
        family = [child, *children_of(child)]
        with pytest.raises(He3Error, match="expected an answer within 1 s of wall-clock time, got none"):
            endless.result(PATIENCE_S)
        assert time.monotonic() - began >= 1.0
        assert behind.result(PATIENCE_S) == 3
        until(lambda: not any(map(alive, family)), "the child and its sleep to die")


def test_a_limit_counts_from_when_the_task_begins_and_does_not_touch_an_answer_in_time():
    with PlannerProcess(parallel=1) as process:
        futures = [process.submit(BoundedTask(time.sleep, 4.0), 1.2) for _ in range(4)]  # 4.8 s in all
        assert [future.result(PATIENCE_S) for future in futures] == [None] * 4


def test_a_bounded_task_is_its_function_where_it_is_called():
    assert BoundedTask(operator.add, 1.0)(1, 2) == 3


def test_a_child_that_closes_its_output_and_goes_on_is_ended(planners):
    with pytest.raises(He3Error, match="signal SIGKILL"):
        planners.submit(close_everything_and_sleep).result(PATIENCE_S)


def close_everything_and_sleep():
    os.closerange(3, 100)
    time.sleep(1000)


def test_cancelling_everything_leaves_the_process_ready():
    with PlannerProcess() as process:
        futures = [process.submit(time.sleep, 1000) for _ in range(5)]
        process.cancel()
        assert all(future.cancelled() for future in futures)
        assert process.submit(operator.add, 1, 2).result(PATIENCE_S) == 3


def test_a_server_that_dies_fails_what_was_pending_and_is_replaced():
    with PlannerProcess() as process:
        futures = [process.submit(time.sleep, 1000) for _ in range(4)]
        server = process._server.pid
        until(lambda: len(children_of(server)) == 2, "the children to start")
        children = children_of(server)
        os.kill(server, signal.SIGKILL)
        for future in futures:
            with pytest.raises(He3Error, match="SIGKILL"):
                future.result(PATIENCE_S)
        until(lambda: not any(map(alive, children)), "the children to die with their server")
        assert process.submit(operator.add, 1, 2).result(PATIENCE_S) == 3


def test_a_closed_process_has_ended_and_refuses_tasks():
    process = PlannerProcess()
    process.close()  # never started: nothing to do
    process = PlannerProcess()
    process.start()
    pending = process.submit(time.sleep, 1000)
    server = process._server
    process.close()
    process.close()
    assert server.poll() is not None
    assert pending.cancelled()
    with pytest.raises(He3Error, match="closed"):
        process.submit(operator.add, 1, 2)


def test_it_needs_room_for_one_task_at_least():
    with pytest.raises(InvalidInput, match="got 0"):
        PlannerProcess(parallel=0)


def test_tasks_of_many_threads_all_get_their_own_answer(planners):
    results = {}

    def ask(k):
        results[k] = [planners.submit(operator.add, k, i).result(PATIENCE_S) for i in range(10)]

    threads = [threading.Thread(target=ask, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
    assert results == {k: [k + i for i in range(10)] for k in range(8)}


OWNER = """
import sys, time, threading
from services.ground.planner_process import PlannerProcess
process = PlannerProcess()
future = process.submit(time.sleep, 1000)
process.submit(time.sleep, 1000)
sys.stdout.write(f"{process._server.pid}\\n")
sys.stdout.flush()
try:
    future.result()
except KeyboardInterrupt:
    process.close()
    sys.exit(7)
"""


def owner():
    return subprocess.Popen([sys.executable, "-c", OWNER], stdout=subprocess.PIPE, text=True, start_new_session=True)


@pytest.mark.parametrize(("end", "status"), [(signal.SIGKILL, -9), (signal.SIGTERM, -15), (signal.SIGINT, 7)])
def test_no_process_is_left_however_the_owner_ends(end, status):
    with owner() as process:
        server = int(process.stdout.readline())
        until(lambda: len(children_of(server)) == 2, "the children to start")
        family = [server, *children_of(server)]
        if end is signal.SIGINT:
            os.killpg(process.pid, end)  # as a terminal does: to everybody
        else:
            process.send_signal(end)
        assert process.wait(PATIENCE_S) == status
        until(lambda: not any(map(alive, family)), "the server and its children to end")


def test_the_owner_answers_others_while_a_plan_is_computed(planners):
    future = planners.submit(sum, range(30_000_000))
    answers = 0
    while not wait([future], timeout=0.001).done:
        answers += sum(range(100)) == 4950
    assert future.result() == sum(range(30_000_000))
    assert answers > 10


QUICK = PlannerOptions(max_iterations=300, extra={"designs": 1, "first_steps": 3, "final_steps": 0})


def quick_for(name):
    return replace(request(), options=QUICK if name == "tour" else replace(QUICK, extra={}))


def test_a_mission_in_one_process_computes_built_in_plans_there_and_they_are_those_of_a_fresh_process(
    monkeypatch, planners
):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    with MissionExecutor() as executor:
        for _ in range(2):  # whatever was planned before
            for name in PLANNERS:
                here = executor.submit(run_planner, name, quick_for(name), 1)
                assert here.done()
                there = planners.submit(run_planner, name, quick_for(name), 1).result(PATIENCE_S)
                np.testing.assert_array_equal(here.result().path_m, there.path_m)
                np.testing.assert_array_equal(here.result().samples_m, there.samples_m)
        assert executor._elsewhere is None


def test_a_mission_in_one_process_has_its_plug_ins_computed_elsewhere(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    with MissionExecutor() as executor:
        limited = BoundedTask(run_planner, PATIENCE_S)
        planned = executor.submit(limited, "examples.most_uncertain:most_uncertain", request(), 0)
        assert len(planned.result(PATIENCE_S).samples_m)
        assert executor._elsewhere is not None


def test_a_planner_that_ignores_the_standard_deviation_plans_the_same_with_another():
    for name in sorted(IGNORE_STD):
        first = quick_for(name)
        other = replace(first, std_ppb=np.ones_like(first.std_ppb))
        np.testing.assert_array_equal(plan(name, first).path_m, plan(name, other).path_m)
