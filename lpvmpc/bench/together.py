"""Many closed loops in one process, side by side: the physics of all cars in one threaded call.

Every run is a generator (`running`) that waits where its car is to be moved. Here all that are
under way are asked one after the other, in this thread, and then `mujoco.batch` moves their cars
for one control period; a car whose run has ended takes the next run. Each run has the bytes that it
has alone: its car's whole state goes into the batch and comes back.

Where a controller is written in Python, its cars wait for one another: on several cores processes
(`batch.drive_all`) do more, as docs/results/speed.md measures.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from inspect import GEN_CLOSED, getgeneratorstate

import mujoco
from mujoco.batch import Batch, SimulationError

from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.interface import State
from lpvmpc.plant.plant import Plant
from lpvmpc.plant.trim import INTEGRATION_STATE
from lpvmpc.sim.batch import Run, arguments, scenario_of
from lpvmpc.sim.guard import Alarm
from lpvmpc.sim.log import Log
from lpvmpc.sim.names import load_controller
from lpvmpc.sim.running import Running, running
from lpvmpc.units import Array

MOST = 4096
"""Most cars side by side; each takes about two megabytes."""


def drive_together(
    runs: Iterable[Run], *, cars: int = 16, threads: int = 0
) -> Iterator[tuple[int, Log | Exception]]:
    """Drive many runs side by side.

    Args:
        runs: What to drive, taken as cars become free.
        cars: How many are under way at a time.
        threads: Threads of the physics, 0 for all cores.

    Yields:
        The number of a run in its order and its Log, or the error for which it has none, as the
        runs end.

    Raises:
        OptionError: No such number of cars or threads.
        KeyboardInterrupt: Ctrl-C; the runs that are under way are dropped.
    """
    if type(cars) is not int or not 1 <= cars <= MOST:
        raise OptionError("cars", cars, f"a whole number from 1 to {MOST}")
    if type(threads) is not int or not 0 <= threads <= 1024:
        raise OptionError("threads", threads, "a whole number from 0 to 1024")
    with Alarm().installed() as alarm, _fleet(cars, threads) as fleet:
        waiting = enumerate(runs)
        free = fleet.seats[::-1]
        under_way: list[_Seat] = []
        while True:
            ended = [seat for seat in under_way if not seat.ask()]
            while free and (item := next(waiting, None)) is not None:
                seat = free.pop()
                seat.begin(*item, alarm)
                (under_way if seat.ask() else ended).append(seat)
            for seat in ended:
                if seat in under_way:
                    under_way.remove(seat)
                free.append(seat)
                yield seat.number, seat.result()
            if under_way:
                fleet.move(under_way)
            elif not ended:
                return


class _Seat:
    """A car, and the run that it drives."""

    def __init__(self, plant: Plant, row: Array) -> None:
        """Args: the car, and its row of the batch's state."""
        self.plant, self.row = plant, row
        self.number = 0
        self.left = 0
        """Physics steps to the next piece of this period."""
        self._run: Running | None = None
        self._state: State | None = None
        self._error: Exception | None = None
        self._end: Log | Exception | None = None

    def begin(self, number: int, run: Run, alarm: Alarm) -> None:
        """Begin a run; what is wrong with it is its result."""
        self.number, self._state, self._error, self._end = number, None, None, None
        self._run = None
        try:
            controller = load_controller(run.controller, **run.controller_options)
            self._run = running(self.plant, controller, scenario_of(run), alarm, **arguments(run))
        except Exception as error:  # the others go on
            self._end = error

    def ask(self) -> bool:
        """Let the run come to where the car is to be moved; whether it came there."""
        run = self._run
        while run is not None:
            try:
                if self._error is None:
                    push = run.send(self._state)  # type: ignore[arg-type]  # None begins it
                else:
                    push = run.throw(self._error)
                self._error = None
                self._pieces = self.plant.segments(push.command, push.wind)
                self.left = next(self._pieces)
                mujoco.mj_getState(self.plant.model, self.plant.data, self.row, INTEGRATION_STATE)
                return True
            except StopIteration as end:
                self._end, self._run = end.value, None
            except Exception as error:
                if getgeneratorstate(run) == GEN_CLOSED:  # the run itself raised, and is over
                    self._end, self._run = error, None
                self._error = error
            run = self._run
        return False

    def result(self) -> Log | Exception:
        """What the run has come to.

        Raises:
            KeyboardInterrupt: It was interrupted.
        """
        end, self._end = self._end, None
        assert end is not None
        if isinstance(end, Log) and end.meta["reason"] == "interrupted":
            raise KeyboardInterrupt
        return end

    def moved(self, steps: int) -> None:
        """The car has made some physics steps of its period in the batch."""
        self.left -= steps
        if self.left:
            return
        self.left = next(self._pieces, 0)
        if self.left:  # the next piece differs in its command alone
            now = self.plant.data.ctrl.copy()
            mujoco.mj_setState(self.plant.model, self.plant.data, self.row, INTEGRATION_STATE)
            self.plant.data.ctrl[:] = now
            mujoco.mj_getState(self.plant.model, self.plant.data, self.row, INTEGRATION_STATE)

    def arrive(self) -> None:
        """The car is where the batch has moved it."""
        mujoco.mj_setState(self.plant.model, self.plant.data, self.row, INTEGRATION_STATE)
        try:
            self._state = self.plant.state
        except LPVMPCError as error:  # it has diverged
            self._error = error

    def fail(self, why: str) -> None:
        """MuJoCo could not move the car."""
        self._error, self.left = RuntimeError(why), 0

    def close(self) -> None:
        """Drop the run, if there is one."""
        if self._run is not None:
            self._run.close()


class _Fleet:
    """Cars and the batch that moves them."""

    def __init__(self, cars: int, threads: int) -> None:
        """Args: number of cars, threads of the physics."""
        plant = Plant()
        plants = [plant, *(Plant(plant.nominal_model) for _ in range(cars - 1))]
        self.nominal = plant.nominal_model
        self.batch = Batch(self.nominal, cars, threads)
        self.seats = [_Seat(p, row) for p, row in zip(plants, self.batch.state, strict=True)]
        self.numbers = {seat: i for i, seat in enumerate(self.seats)}
        self.level = self._gravity(self.nominal)
        self.models = [(self.nominal, self.level)] * cars

    def move(self, seats: list[_Seat]) -> None:
        """Move the cars of some seats for one control period."""
        self._set_models(seats)
        while moving := [seat for seat in seats if seat.left]:
            steps = min(seat.left for seat in moving)
            try:
                self.batch.step(sorted(self.numbers[seat] for seat in moving), nstep=steps)
            except SimulationError as error:
                for i in error.ids.tolist():
                    self.seats[i].fail(self.batch.error(i))
            for seat in moving:
                if seat.left:
                    seat.moved(steps)
        for seat in seats:
            seat.arrive()

    def _set_models(self, seats: list[_Seat]) -> None:
        """Give the batch each car's model, where one is another or its road has turned."""
        changed = False
        for seat in seats:
            model, i = seat.plant.model, self.numbers[seat]
            gravity = self._gravity(model)
            if model is seat.plant.nominal_model and gravity == self.level:
                model = self.nominal  # one for all: less memory to go through
            if self.models[i][0] is not model or self.models[i][1] != gravity:
                self.models[i], changed = (model, gravity), True
        if changed:
            models = [model for model, _ in self.models]
            plain = all(model is self.nominal for model in models)
            self.batch.set_models(None if plain else models)

    @staticmethod
    def _gravity(model: mujoco.MjModel) -> tuple[float, ...]:
        return tuple(model.opt.gravity.tolist())


@contextmanager
def _fleet(cars: int, threads: int) -> Iterator[_Fleet]:
    """A fleet; the runs that are under way at the end are dropped."""
    fleet = _Fleet(cars, threads)
    try:
        yield fleet
    finally:
        for seat in fleet.seats:
            seat.close()
