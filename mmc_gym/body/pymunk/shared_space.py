"""Some equal arms that share a pymunk Space, and what one call does to all of them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
import pymunk
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import lib as chipmunk
from pymunk.batch import BodyFields, Buffer, get_space_bodies, set_space_bodies

from mmc_gym.body.parameters import ArmParameters, Servo
from mmc_gym.body.pymunk.linkage import Linkage, forget_impulses, make_space

Floats = NDArray[np.float64]


class Observer(Protocol):
    """Whoever looks at the arms of a Space within a control step; nothing may be changed."""

    def begin(self, space: SharedSpace) -> None:
        """A control step is about to begin."""

    def observe(self, space: SharedSpace) -> None:
        """A physics step of it is over."""


class SharedSpace:
    """Arms that share a Space: `count` of them, beginning with number `first` of all.

    Attributes:
        observer: is called in every physics step; None for nobody.
    """

    observer: Observer | None = None

    def __init__(self, parameters: ArmParameters, servo: Servo, first: int, count: int) -> None:
        self.first, self.count, self.arms = first, count, slice(first, first + count)
        self._parameters, self._servo = parameters, servo
        self._buffer, self._push_buffer = Buffer(), Buffer()
        bodies = count * len(parameters.segment_lengths) + bool(parameters.obstacles)
        self._pushes = np.zeros((bodies, 3))  # force x, y and torque; the obstacles are one body
        self._push_buffer.set_float_buf(self._pushes)
        self._build()

    def _build(self) -> None:
        self._space = make_space(self._parameters)
        self.linkages = [
            Linkage(self._space, self._parameters, self._servo) for _ in range(self.count)
        ]
        self._servo_handles = [
            servo._constraint for linkage in self.linkages for servo in linkage.servos
        ]

    def drive(self, settings: Floats, torques: Floats) -> None:
        """Set the servos: their phases or rates, and their largest torques, (count, N)."""
        servos = self._servo_handles
        if self._servo == "position":
            _for_each(chipmunk.cpGearJointSetPhase, servos, settings)
        else:
            _for_each(chipmunk.cpSimpleMotorSetRate, servos, settings)
        if self._servo == "torque":
            _for_each(chipmunk.cpConstraintSetMaxForce, servos, torques)

    def step(self) -> None:
        """Simulate one control step."""
        space, substep, observer = self._space._space, self._parameters.substep, self.observer
        if observer is not None:
            observer.begin(self)
        for _ in range(self._parameters.substeps):
            if self._parameters.force_field is not None:
                self._push_hands()
            chipmunk.cpSpaceStep(space, substep)
            if observer is not None:
                observer.observe(self)

    def joint_velocities(self) -> Floats:
        """Velocities of the joints after the last physics step, rad/s, (count, N)."""
        absolute = self._get(BodyFields.ANGULAR_VELOCITY)[:, :, 0]
        return np.diff(absolute, axis=-1, prepend=0.0)

    def servo_impulses(self) -> Floats:
        """Sizes of the servos' angular impulses in the last physics step, (count, N)."""
        given = list(map(chipmunk.cpConstraintGetImpulse, self._servo_handles))
        return np.array(given).reshape(self.count, -1)

    def _get(self, fields: BodyFields) -> Floats:
        """These fields of all segments, (count, N, values), until the next call."""
        self._buffer.clear()
        get_space_bodies(self._space, fields, self._buffer)
        values = np.frombuffer(self._buffer.float_buf()).reshape(len(self._pushes), -1)
        joints = len(self._parameters.segment_lengths)
        return values[: self.count * joints].reshape(self.count, joints, -1)

    def read(self, angles: Floats, velocities: Floats) -> None:
        """Write the segments' angles and angular velocities to two arrays (count, N)."""
        state = self._get(BodyFields.ANGLE | BodyFields.ANGULAR_VELOCITY)
        angles[:], velocities[:] = state[:, :, 0], state[:, :, 1]

    def _push_hands(self) -> None:
        """Let the force field act on the hands in the next physics step."""
        assert self._parameters.force_field is not None
        (xx, xy), (yx, yy) = self._parameters.force_field
        fields = BodyFields.ANGLE | BodyFields.VELOCITY | BodyFields.ANGULAR_VELOCITY
        angle, centre_x, centre_y, speed = self._get(fields)[:, -1].T
        along_x, along_y = cosine(angle), sine(angle)
        _, reach = self.linkages[0].hand
        x, y = centre_x - reach * speed * along_y, centre_y + reach * speed * along_x
        force_x, force_y = xx * x + xy * y, yx * x + yy * y
        joints = len(self._parameters.segment_lengths)
        last = self._pushes[joints - 1 : self.count * joints : joints]
        last[:, 0], last[:, 1] = force_x, force_y
        last[:, 2] = reach * (along_x * force_y - along_y * force_x)
        set_space_bodies(self._space, BodyFields.FORCE | BodyFields.TORQUE, self._push_buffer)

    def reset(
        self,
        members: Sequence[int],
        joint_angles: Sequence[Sequence[float]],
        joint_velocities: Sequence[Sequence[float]],
        scratch: pymunk.Space,
    ) -> None:
        """Place some of the arms; `scratch` is an empty Space."""
        substep = self._parameters.substep
        linkages = [self.linkages[member] for member in members]
        if self._parameters.obstacles:
            self._build()
            linkages = self.linkages
        elif len(linkages) == self.count:
            forget_impulses(self._space, linkages, substep)
        else:  # the other arms must not move
            for linkage in linkages:
                linkage.move_joints(self._space, scratch)
            forget_impulses(scratch, linkages, substep)
            for linkage in linkages:
                linkage.move_joints(scratch, self._space)
        for linkage, posture, speeds in zip(linkages, joint_angles, joint_velocities):
            linkage.place(posture, speeds)


def _for_each(function: Callable[[Any, float], None], handles: Sequence[Any], x: Floats) -> None:
    deque(map(function, handles, x.ravel().tolist()), maxlen=0)


def _like_the_c_library(ufunc: np.ufunc, function: Callable[[float], float]) -> Any:
    """`ufunc`, unless numpy was built with another cosine than the one Python and Chipmunk use."""
    sample = np.linspace(-50.0, 50.0, 4099)
    same = ufunc(sample).tolist() == [function(x) for x in sample.tolist()]
    return ufunc if same else np.vectorize(function, otypes=[np.float64])


cosine = _like_the_c_library(np.cos, math.cos)
sine = _like_the_c_library(np.sin, math.sin)
