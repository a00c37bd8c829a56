// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @notice What a WeightTree finds keys by: two parts, `weigh(major, minor)`, which are compared separately.
type Weight is uint64;

uint256 constant MINOR_BITS = 6;
uint64 constant MAX_MINOR = uint64((1 << MINOR_BITS) - 1);
uint64 constant MAX_MAJOR = type(uint64).max >> MINOR_BITS;

/// @dev The least weight.
Weight constant NO_WEIGHT = Weight.wrap(0);
/// @dev What is left of a weight & MAJOR: its major part, where it stands.
Weight constant MAJOR = Weight.wrap(~MAX_MINOR);
/// @dev What is left of a weight & MINOR: its minor part.
Weight constant MINOR = Weight.wrap(MAX_MINOR);

using {equal as ==, differ as !=, greater as >, less as <, both as &, either as |, majorOf} for Weight global;

/// @notice A weight of two parts, at most MAX_MAJOR and MAX_MINOR.
function weigh(uint64 major, uint64 minor) pure returns (Weight) {
    return Weight.wrap((major << uint64(MINOR_BITS)) | minor);
}

/// @notice The major part of a weight.
function majorOf(Weight weight) pure returns (uint64) {
    return Weight.unwrap(weight) >> uint64(MINOR_BITS);
}

function equal(Weight a, Weight b) pure returns (bool) {
    return Weight.unwrap(a) == Weight.unwrap(b);
}

function differ(Weight a, Weight b) pure returns (bool) {
    return Weight.unwrap(a) != Weight.unwrap(b);
}

function greater(Weight a, Weight b) pure returns (bool) {
    return Weight.unwrap(a) > Weight.unwrap(b);
}

function less(Weight a, Weight b) pure returns (bool) {
    return Weight.unwrap(a) < Weight.unwrap(b);
}

function both(Weight a, Weight b) pure returns (Weight) {
    return Weight.wrap(Weight.unwrap(a) & Weight.unwrap(b));
}

function either(Weight a, Weight b) pure returns (Weight) {
    return Weight.wrap(Weight.unwrap(a) | Weight.unwrap(b));
}
