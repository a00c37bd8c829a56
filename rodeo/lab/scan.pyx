# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""What a planar scanner meets, in compiled code: each geom is tried only by those beams that can meet it.

`mj_multiRay` tries each geom of a body by each of its beams, which for a scan of a lab with five robots takes as
long as two steps of its physics. Whether and where a beam meets a geom is MuJoCo's own answer here, too.
"""

from libc.math cimport INFINITY, M_PI, asin, atan2, ceil, fabs, floor, remainder, sqrt
from libc.stdint cimport uintptr_t

import numpy as np

cdef enum:
    PLANE = 0
    HFIELD = 1
    BOX = 6
    MESH = 7
"""mjtGeom, up to the last one that has a function of rays of its own."""

# As mujoco.h declares them; mjtNum is a double.
ctypedef double (*RayGeom)(
    const double *position, const double *turn, const double *size, const double *eye, const double *ray,
    int kind, double *normal) noexcept nogil
ctypedef double (*RayShape)(
    const void *model, const void *data, int geom, const double *eye, const double *ray,
    double *normal) noexcept nogil

cdef double _ROUNDING = 1e-6
"""m or beams: a geom is tried by too many beams rather than by too few."""


cdef class Scanner:
    """Beams from one point in a plane, at angles that rise in equal steps once round.

    Args:
        geoms: (n,) MuJoCo's numbers of what is seen. Raises ValueError for a kind of geom that MuJoCo itself
            does not cast rays at alone.
        beams: how many; the first one is at -pi.
        farthest_m: what is further away is not met.
        ray_geom, ray_mesh, ray_hfield: addresses of MuJoCo's functions.
    """

    cdef const void *_model
    cdef RayGeom _ray_geom
    cdef RayShape _ray_mesh, _ray_hfield
    cdef int[::1] _geoms, _kinds
    cdef double[::1] _bounds_m
    cdef double[:, ::1] _sizes_m
    cdef int _beams
    cdef double _farthest_m
    cdef object _kept

    def __init__(self, model, geoms, int beams, double farthest_m,
                 uintptr_t ray_geom, uintptr_t ray_mesh, uintptr_t ray_hfield):
        kinds = model.geom_type[geoms]
        if (kinds > MESH).any():
            raise ValueError(f"no scanner sees geoms of the kinds {sorted(set(kinds[kinds > MESH].tolist()))}")
        self._kept = model  # whose address is used
        self._model = <const void *><uintptr_t>model._address
        self._ray_geom = <RayGeom>ray_geom
        self._ray_mesh, self._ray_hfield = <RayShape>ray_mesh, <RayShape>ray_hfield
        self._geoms, self._kinds = np.array(geoms, np.intc), np.array(kinds, np.intc)
        self._bounds_m = model.geom_rbound[geoms].copy()
        self._sizes_m = model.geom_size[geoms].copy()
        self._beams, self._farthest_m = beams, farthest_m

    def ranges(self, data, const double[::1] eye, const double[:, ::1] axes, const double[:, ::1] rays):
        """(beams,) m to what each beam meets first, infinite where there is nothing.

        Args:
            eye: (3,) where the beams begin, in the world.
            axes: (3, 3) the scanner's axes as columns; the beams lie in the plane of the first two, the beam
                at 0 along the first.
            rays: (beams, 3) their directions in the world.
        """
        ranges_m = np.full(self._beams, INFINITY)
        cdef double[::1] nearest_m = ranges_m
        cdef const double[:, ::1] places_m = data.geom_xpos, turns = data.geom_xmat
        cdef const void *at = <const void *><uintptr_t>data._address
        with nogil:
            self._cast(at, eye, axes, rays, places_m, turns, nearest_m)
        return ranges_m

    cdef void _cast(self, const void *data, const double[::1] eye, const double[:, ::1] axes,
                    const double[:, ::1] rays, const double[:, ::1] places_m, const double[:, ::1] turns,
                    double[::1] nearest_m) noexcept nogil:
        cdef int number, geom, kind, beam, first, last, count = self._beams
        cdef double met_m
        for number in range(self._geoms.shape[0]):
            geom, kind = self._geoms[number], self._kinds[number]
            if not self._reach(number, eye, axes, &places_m[geom, 0], &turns[geom, 0], &first, &last):
                continue
            for beam in range(first, last + 1):
                beam %= count
                if kind == MESH:
                    met_m = self._ray_mesh(self._model, data, geom, &eye[0], &rays[beam, 0], NULL)
                elif kind == HFIELD:
                    met_m = self._ray_hfield(self._model, data, geom, &eye[0], &rays[beam, 0], NULL)
                else:
                    met_m = self._ray_geom(&places_m[geom, 0], &turns[geom, 0], &self._sizes_m[number, 0],
                                           &eye[0], &rays[beam, 0], kind, NULL)
                if 0 <= met_m < nearest_m[beam] and met_m <= self._farthest_m:
                    nearest_m[beam] = met_m

    cdef bint _reach(self, int number, const double[::1] eye, const double[:, ::1] axes,
                     const double *place_m, const double *turn, int *first, int *last) noexcept nogil:
        """Whether any beam can meet this geom; and which, from `first` to `last`, counted on beyond a turn."""
        cdef double bound_m = self._bounds_m[number] + _ROUNDING
        cdef double across_m, off_m, middle, half, low, high
        cdef double ahead_m[3]
        first[0], last[0] = self._beams, 2 * self._beams - 1
        if self._kinds[number] in (PLANE, HFIELD):
            return True
        _within(eye, axes, place_m, ahead_m)
        if not fabs(ahead_m[2]) <= bound_m:
            return False
        # Where the plane of the beams cuts the ball around the geom.
        across_m = sqrt(bound_m * bound_m - ahead_m[2] * ahead_m[2])
        off_m = sqrt(ahead_m[0] * ahead_m[0] + ahead_m[1] * ahead_m[1])
        if off_m - across_m > self._farthest_m:
            return False
        middle = atan2(ahead_m[1], ahead_m[0])
        if off_m > across_m:
            half = asin(across_m / off_m)
            low, high = -half, half
        else:
            low, high = -M_PI, M_PI
        if self._kinds[number] == BOX and high - low > M_PI / 4:
            # A wall's ball fills the room.
            _corners(eye, axes, place_m, turn, &self._sizes_m[number, 0], middle, &low, &high)
        if high - low < M_PI:
            first[0] = self._beams + <int>floor(self._beam(middle + low) - _ROUNDING)
            last[0] = self._beams + <int>ceil(self._beam(middle + high) + _ROUNDING)
        return True

    cdef double _beam(self, double angle_rad) noexcept nogil:
        return (angle_rad + M_PI) * self._beams / (2 * M_PI)


cdef void _within(const double[::1] eye, const double[:, ::1] axes, const double *point_m,
                  double *ahead_m) noexcept nogil:
    """The point in the scanner's frame."""
    cdef double x = point_m[0] - eye[0], y = point_m[1] - eye[1], z = point_m[2] - eye[2]
    cdef int k
    for k in range(3):
        ahead_m[k] = axes[0, k] * x + axes[1, k] * y + axes[2, k] * z


cdef void _corners(const double[::1] eye, const double[:, ::1] axes, const double *place_m, const double *turn,
                   const double *size_m, double middle, double *low, double *high) noexcept nogil:
    """From where to where a box is, relative to the angle of its centre.

    It is convex: seen from outside it fills less than half a turn, between two of its corners. From within its
    outline the corners are all around.
    """
    cdef double corner_m[3]
    cdef double ahead_m[3]
    cdef double along, least = INFINITY, most = -INFINITY
    cdef int corner, k
    for corner in range(8):
        for k in range(3):
            corner_m[k] = (
                place_m[k]
                + turn[3 * k] * (size_m[0] if corner & 1 else -size_m[0])
                + turn[3 * k + 1] * (size_m[1] if corner & 2 else -size_m[1])
                + turn[3 * k + 2] * (size_m[2] if corner & 4 else -size_m[2])
            )
        _within(eye, axes, corner_m, ahead_m)
        along = remainder(atan2(ahead_m[1], ahead_m[0]) - middle, 2 * M_PI)
        least, most = min(least, along), max(most, along)
    # Not of a box that is nowhere: NaN.
    if 0 <= most - least < M_PI:
        low[0], high[0] = max(low[0], least), min(high[0], most)
