# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""What is published of each control period, made for many periods at once, in compiled code.

Each message is its template with stamps and numbers written over what was there. Numbers are as the machine has
them, which is as CDR wants them wherever MuJoCo runs.
"""

from cpython.bytes cimport PyBytes_AS_STRING, PyBytes_FromStringAndSize
from libc.math cimport cos, sin
from libc.stdint cimport int32_t, int64_t, uint32_t
from libc.string cimport memcpy

import numpy as np

cdef int64_t _SECOND_NS = 1_000_000_000
cdef enum:
    NUMBER_BYTES = 8
    POSE = 7


cdef class Rows:
    """The same message of several times.

    Args:
        template: the message in CDR.
        stamps: (s,) at which bytes its stamps begin: seconds, then nanoseconds.
        places: (n,) at which bytes its numbers begin that change, all float64.
    """

    cdef bytes _template
    cdef const int[::1] _stamps, _places

    def __init__(self, bytes template, stamps, places):
        last = max([int(at) + NUMBER_BYTES for at in (*stamps, *places)])
        if last > len(template):
            raise ValueError(f"a message of {len(template)} bytes has no number that ends at {last}")
        self._template = template
        self._stamps, self._places = np.array(stamps, np.intc), np.array(places, np.intc)

    def encode(self, const int64_t[::1] time_ns, *blocks):
        """CDR for each time (k,), with each block (index of the first number, numbers (k, m)) written over what
        was there. Raises ValueError for a block that does not fit."""
        cdef Py_ssize_t size = len(self._template), count = time_ns.shape[0], row, column, first
        cdef const char *template = PyBytes_AS_STRING(self._template)
        cdef const double[:, :] numbers
        cdef int32_t seconds
        cdef uint32_t nanoseconds
        cdef char *start
        messages = []
        for row in range(count):
            message = PyBytes_FromStringAndSize(NULL, size)
            start = PyBytes_AS_STRING(message)
            memcpy(start, template, size)
            seconds, nanoseconds = <int32_t>(time_ns[row] // _SECOND_NS), <uint32_t>(time_ns[row] % _SECOND_NS)
            for column in range(self._stamps.shape[0]):
                memcpy(start + self._stamps[column], &seconds, sizeof(seconds))
                memcpy(start + self._stamps[column] + sizeof(seconds), &nanoseconds, sizeof(nanoseconds))
            messages.append(message)
        for first, block in blocks:
            numbers = block
            if first < 0 or first + numbers.shape[1] > self._places.shape[0] or numbers.shape[0] != count:
                raise ValueError(
                    f"{numbers.shape[1]} numbers from the {first}th on for {numbers.shape[0]} times do not fit into"
                    f" {self._places.shape[0]} numbers for {count}"
                )
            for row in range(count):
                start = PyBytes_AS_STRING(messages[row])
                for column in range(numbers.shape[1]):
                    memcpy(start + self._places[first + column], &numbers[row, column], NUMBER_BYTES)
        return messages


def reckoned_poses(const double[:, :] reckoned):
    """(k, 7) x, y, z, qx, qy, qz, qw in the frame odom and (k, 6) twists of a base whose wheels have it at
    `reckoned` (k, 5): x and y in m, yaw in rad, m/s forwards, rad/s."""
    cdef Py_ssize_t k, count = reckoned.shape[0]
    poses, twists = np.zeros((count, POSE)), np.zeros((count, 6))
    cdef double[:, ::1] pose = poses, twist = twists
    for k in range(count):
        pose[k, 0], pose[k, 1] = reckoned[k, 0], reckoned[k, 1]
        pose[k, 5], pose[k, 6] = sin(reckoned[k, 2] / 2), cos(reckoned[k, 2] / 2)
        twist[k, 0], twist[k, 5] = reckoned[k, 3], reckoned[k, 4]
    return poses, twists


def odom_in_map(const double[:, :] base_m, const double[:, :] base_quat, const double[:, :] reckoned):
    """(k, 7) poses (x, y, z, qx, qy, qz, qw) in the map of the frame that has the base where it is `reckoned`
    (k, 3 or more): x, y in m and yaw in rad, and the map at `base_m` (k, 3) with `base_quat` (k, 4) w, x, y, z."""
    cdef Py_ssize_t k, count = reckoned.shape[0]
    poses = np.empty((count, POSE))
    cdef double[:, ::1] pose = poses
    cdef double c, s, x_m, y_m, w, x, y, z
    for k in range(count):
        x_m, y_m = reckoned[k, 0], reckoned[k, 1]
        c, s = cos(reckoned[k, 2] / 2), -sin(reckoned[k, 2] / 2)
        w = base_quat[k, 0] * c - base_quat[k, 3] * s
        x = base_quat[k, 1] * c + base_quat[k, 2] * s
        y = base_quat[k, 2] * c - base_quat[k, 1] * s
        z = base_quat[k, 3] * c + base_quat[k, 0] * s
        pose[k, 0] = base_m[k, 0] - (1 - 2 * (y * y + z * z)) * x_m - 2 * (x * y - w * z) * y_m
        pose[k, 1] = base_m[k, 1] - 2 * (x * y + w * z) * x_m - (1 - 2 * (x * x + z * z)) * y_m
        pose[k, 2] = base_m[k, 2] - 2 * (x * z - w * y) * x_m - 2 * (y * z + w * x) * y_m
        pose[k, 3], pose[k, 4], pose[k, 5], pose[k, 6] = x, y, z, w
    return poses


def poses_in_parents(const double[:, :, ::1] places_m, const double[:, :, ::1] quaternions,
                     const double[:, :, ::1] turns, const int[::1] bodies, const int[::1] parents):
    """(k, n, 7) x, y, z, qx, qy, qz, qw of n `bodies` in the frames of their `parents`, from all bodies at k
    times: `mjData.xpos` (k, all, 3), `xquat` (k, all, 4) and `xmat` (k, all, 9)."""
    cdef Py_ssize_t k, n, axis, count = places_m.shape[0]
    poses = np.empty((count, bodies.shape[0], POSE))
    cdef double[:, :, ::1] pose = poses
    cdef const double *place_m
    cdef const double *parent_m
    cdef const double *turn
    cdef const double *p
    cdef const double *q
    for k in range(count):
        for n in range(bodies.shape[0]):
            place_m, parent_m = &places_m[k, bodies[n], 0], &places_m[k, parents[n], 0]
            turn = &turns[k, parents[n], 0]
            for axis in range(3):
                pose[k, n, axis] = (
                    (place_m[0] - parent_m[0]) * turn[axis]
                    + (place_m[1] - parent_m[1]) * turn[3 + axis]
                    + (place_m[2] - parent_m[2]) * turn[6 + axis]
                )
            # The conjugate of the parent's quaternion times the body's.
            p, q = &quaternions[k, parents[n], 0], &quaternions[k, bodies[n], 0]
            pose[k, n, 3] = p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
            pose[k, n, 4] = p[0] * q[2] + p[1] * q[3] - p[2] * q[0] - p[3] * q[1]
            pose[k, n, 5] = p[0] * q[3] - p[1] * q[2] + p[2] * q[1] - p[3] * q[0]
            pose[k, n, 6] = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    return poses
