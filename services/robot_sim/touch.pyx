# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Whether something in a world is or may soon be touched, asked before each control period, in compiled code."""

from libc.math cimport fabs, sqrt

import numpy as np


cdef class Touch:
    """Reads the arrays of a world, which stay where they are for its life.

    Args:
        items: MuJoCo's numbers of the bodies that can be touched and moved, each with a free joint.
        bases, hands: of the robots' base_links (bodies), and of where their pads meet (sites).
        item_dofs, base_dofs: (items, 6), (robots, 6) of their speeds in `qvel`.
        fingers: (robots, 2) of the fingers' positions in `qpos`.
        rest, still: (nv,) below which each speed counts as rest, and the most that each may be in a world where
            nothing is touched.
        reach_m, hand_near_m, held_m, base_near_m, standing_speed, holds_below_m: see steps.py.
    """

    cdef const double[::1] _position, _velocity
    cdef const double[:, ::1] _bodies_m, _sites_m
    cdef const int[::1] _items, _bases, _hands
    cdef const int[:, ::1] _item_dofs, _base_dofs, _fingers
    cdef const double[::1] _rest, _still
    cdef double _reach_m, _hand_near_m, _held_m, _base_near_m, _standing_speed, _holds_below_m
    cdef char[::1] _excused
    """(nv,) whose speed does not count: of what is held."""

    def __init__(self, data, items, bases, hands, item_dofs, base_dofs, fingers, rest, still, *,
                 double reach_m, double hand_near_m, double held_m, double base_near_m, double standing_speed,
                 double holds_below_m):
        self._position, self._velocity = data.qpos, data.qvel
        self._bodies_m, self._sites_m = data.xpos, data.site_xpos
        self._items, self._bases, self._hands = (np.array(one, np.intc) for one in (items, bases, hands))
        self._item_dofs = np.array(item_dofs, np.intc).reshape(-1, 6)
        self._base_dofs = np.array(base_dofs, np.intc).reshape(-1, 6)
        self._fingers = np.array(fingers, np.intc).reshape(-1, 2)
        self._rest, self._still = rest, still
        self._reach_m, self._hand_near_m, self._held_m = reach_m, hand_near_m, held_m
        self._base_near_m, self._standing_speed = base_near_m, standing_speed
        self._holds_below_m = holds_below_m
        self._excused = np.zeros(len(rest), np.int8)

    def rests(self):
        """Whether nothing moves at all."""
        for dof in range(self._rest.shape[0]):
            if not fabs(self._velocity[dof]) < self._rest[dof]:
                return False
        return True

    def state(self):
        """Whether something is or may be touched, and whether something rests in a closed gripper."""
        cdef Py_ssize_t item, robot, dof
        cdef double base_m, hand_m
        cdef bint held = False
        self._excused[:] = 0
        for robot in range(self._bases.shape[0]):
            for item in range(self._items.shape[0]):
                base_m = self._apart_m(self._bodies_m[self._items[item]], self._bodies_m[self._bases[robot]], 2)
                if base_m >= self._reach_m:
                    continue
                hand_m = self._apart_m(self._bodies_m[self._items[item]], self._sites_m[self._hands[robot]], 3)
                if hand_m < self._held_m and self._closed(robot):
                    held = True
                    for dof in range(6):
                        self._excused[self._item_dofs[item, dof]] = 1
                elif hand_m < self._hand_near_m or (base_m < self._base_near_m and self._drives(robot)):
                    return True, held
        for dof in range(self._still.shape[0]):
            if fabs(self._velocity[dof]) > self._still[dof] and not self._excused[dof]:
                return True, held
        return False, held

    cdef double _apart_m(self, const double[::1] one_m, const double[::1] other_m, int axes):
        cdef double square = 0
        for axis in range(axes):
            square += (one_m[axis] - other_m[axis]) * (one_m[axis] - other_m[axis])
        return sqrt(square)

    cdef bint _closed(self, Py_ssize_t robot):
        """Whether the robot's fingers may hold something."""
        return (
            fabs(self._position[self._fingers[robot, 0]]) < self._holds_below_m
            or fabs(self._position[self._fingers[robot, 1]]) < self._holds_below_m
        )

    cdef bint _drives(self, Py_ssize_t robot):
        for dof in range(6):
            if fabs(self._velocity[self._base_dofs[robot, dof]]) > self._standing_speed:
                return True
        return False
