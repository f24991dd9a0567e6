"""The one that commands a drone: whatever changes its mode or moves it goes through its commander, one thing at a time.

The guard, which must work when nothing else does, is the one other. Source: X3, X4, design "Motion", decisions 4 and 15.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from m3r_app.vehicle.interface import ObservedVehicle, Vehicle, VehicleError
from m3r_app.vehicle.motion_controller import MotionController
from m3r_app.vehicle.telemetry import Telemetry
from safety.limits import Limits
from safety.vocabulary import FlightMode, Ned, Plan

HOLD_S = 5.0
"""So long STOP waits for Hold."""
MODE_LAG_S = 0.2
"""A flight mode that was reported earlier than this after we changed it may be the old one."""


class Commander:
    """Commands one drone; what is commanded ends what was commanded before. From the event loop only."""

    def __init__(self, vehicle: Vehicle, clock: Callable[[], float]) -> None:
        self.vehicle: ObservedVehicle = vehicle
        self._vehicle = vehicle
        self._clock = clock
        self._under_way: asyncio.Task[None] | None = None
        """A take-off, landing or Hold that is not known to be over; cancelled, it was given up by whoever asked for it."""
        self._controller: MotionController | None = None
        self._streaming: asyncio.Task[None] | None = None
        self._commanded_at_s = -math.inf

    # ------------------------------------------------------------ outside of a session

    async def hold(self) -> None:
        """The autopilot's own Hold. Raises VehicleError, as all three do where something else is commanded meanwhile."""
        await self._alone("Hold", self._vehicle.hold())

    async def take_off(self, metres: float) -> None:
        """Take off to `metres` above here, and wait there in Hold. Raises VehicleError."""
        await self._alone("the take-off", self._vehicle.takeoff(metres))

    async def land(self) -> None:
        """Come down here, until it stands. Raises VehicleError."""
        await self._alone("the landing", self._vehicle.land())

    async def stop(self) -> bool:
        """End what is under way outside of a session, in Hold; False: nothing is. Raises VehicleError. Source: X4."""
        if self._under_way is None and self._vehicle.telemetry().flight_mode is not FlightMode.TAKEOFF:
            return False
        try:
            async with asyncio.timeout(HOLD_S):
                await self.hold()
        except TimeoutError:
            raise VehicleError(f"{self.vehicle.colour.capitalize()}: did not answer to Hold") from None
        return True

    async def _alone(self, what: str, command: Coroutine[Any, Any, None]) -> None:
        self._end()
        task = self._under_way = asyncio.create_task(command)
        try:
            await task
        except asyncio.CancelledError:
            asking = asyncio.current_task()
            if asking is not None and asking.cancelling():
                raise
            raise VehicleError(f"{self.vehicle.colour}: {what} was ended by what was commanded after it.") from None
        finally:
            if self._under_way is task and not task.cancelled():
                self._under_way = None

    def _end(self) -> None:
        if self._under_way is not None:
            self._under_way.cancel()
        self._under_way = None

    # ------------------------------------------------------------ in a session

    def engage(
        self,
        limits: Limits,
        beat: Callable[[], None],
        stalled: Callable[[str], None],
        sent: Callable[[float, Ned, float], None],
    ) -> None:
        """Send setpoints at 50 Hz from the first order on, until let go. What they are told is as in MotionController."""
        self._end()
        self._controller = MotionController(
            self._vehicle,
            self._clock,
            limits.yaw_rate_deg_s,
            limits.yaw_acceleration_deg_s2,
            beat,
            stalled,
            sent,
            limits.lag_s,
        )
        self._stream(self._controller, stalled)

    def _stream(self, controller: MotionController, stalled: Callable[[str], None]) -> None:
        """What breaks the sending drops what is flown; then it goes on."""
        self._streaming = asyncio.create_task(controller.run())

        def broken(task: asyncio.Task[None]) -> None:
            error = None if task.cancelled() else task.exception()
            if error is None or self._controller is not controller:
                return
            controller.disengaged()
            stalled(f"setpoints could not be sent ({error})")
            self._stream(controller, stalled)

        self._streaming.add_done_callback(broken)

    async def face(self, bearing_deg: float) -> None:
        """Hover here and turn the nose to bearing_deg. Raises VehicleError."""
        await self._order(lambda controller: controller.face(bearing_deg))

    async def fly(self, plan: Plan, shift: Ned) -> None:
        """Stream `plan`; shift: session frame to the vehicle's own, added. Raises VehicleError."""
        await self._order(lambda controller: controller.fly(plan, shift))

    async def _order(self, order: Callable[[MotionController], Awaitable[None]]) -> None:
        controller = self._controller
        if controller is None:
            return
        self._commanded_at_s = self._clock()
        try:
            await order(controller)
        finally:
            self._commanded_at_s = self._clock()

    def hover(self) -> None:
        """Stop here now, yaw too. Source: X4, R10."""
        if self._controller is not None:
            self._controller.hold()

    def disengaged(self) -> None:
        """It is in Offboard no longer: what was flown is over, the next order enters it anew."""
        if self._controller is not None:
            self._controller.disengaged()

    def let_go(self, command: str) -> Awaitable[None]:
        """No order reaches it any more, at once. What is awaited raises VehicleError, and is over when the drone is free.

        command: `hold`, `resume` (its mission), `land`, or `nothing` after a takeover (X3).
        """
        controller, streaming = self._controller, self._streaming
        self._controller = self._streaming = None

        async def carry_out() -> None:
            if streaming is not None:
                streaming.cancel()
            if controller is not None:
                await controller.let_go(command)

        return carry_out()

    async def close(self) -> None:
        """No setpoint is made any more, whatever is flown."""
        if self._streaming is not None:
            self._streaming.cancel()
            await asyncio.gather(self._streaming, return_exceptions=True)

    def hold_unless_taken_over(self, timeout_s: float) -> None:
        """For the guard, from any thread: Hold, unless somebody else flies it. Raises VehicleError."""
        self._vehicle.hold_unless_taken_over(timeout_s)

    # ------------------------------------------------------------ what its mode means, given what was commanded

    def flight_mode(self, telemetry: Telemetry) -> FlightMode:
        """The mode as reported, or as commanded while the report is still the old one (it comes once a second)."""
        controller = self._controller
        if controller is None or telemetry.flight_mode is FlightMode.UNKNOWN or not self._is_old(telemetry):
            return telemetry.flight_mode
        return FlightMode.OFFBOARD if controller.engaged else FlightMode.HOLD

    def unasked_hold(self, telemetry: Telemetry) -> bool:
        """Whether it left Offboard for Hold and we did not command it; the guard's Hold counts. Source: X3."""
        engaged = self._controller is not None and self._controller.engaged
        return engaged and telemetry.flight_mode is FlightMode.HOLD and not self._is_old(telemetry)

    def _is_old(self, telemetry: Telemetry) -> bool:
        """Whether the mode may have been told before it was changed by us."""
        return telemetry.mode_at_s < self._commanded_at_s + MODE_LAG_S
