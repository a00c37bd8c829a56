// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @notice The providers that had a task and did not do it, so that it is not offered to them again. At most eight, 32 bits
/// each, the last in the lowest: the provider's number (31 bits), and whether it gave the work up after a proof (1 bit).
type Passed is uint256;

/// @dev Of a task that every provider may do.
Passed constant NOBODY = Passed.wrap(0);

/// @dev Entries from which on proven providers alone are offered the task, and with which it ends.
uint256 constant PROVEN_FROM = 4;
uint256 constant MAX_PASSED = 8;

using {isEmpty, count, has, add, isForProven, isFull, someoneGaveUp} for Passed global;

function isEmpty(Passed passed) pure returns (bool) {
    return Passed.unwrap(passed) == 0;
}

/// @notice How many providers the task has passed.
function count(Passed passed) pure returns (uint256 number) {
    for (uint256 word = Passed.unwrap(passed); word != 0; word >>= 32) {
        ++number;
    }
}

/// @notice Whether the provider with this number is one of them. No provider has the number 0.
function has(Passed passed, uint32 number) pure returns (bool) {
    for (uint256 word = Passed.unwrap(passed); word != 0; word >>= 32) {
        if (uint32(word) >> 1 == number) return true;
    }
    return false;
}

/// @notice The list with another provider; see isFull.
function add(Passed passed, uint32 number, bool gaveUp) pure returns (Passed) {
    return Passed.wrap(Passed.unwrap(passed) << 32 | uint256(number) << 1 | (gaveUp ? 1 : 0));
}

/// @notice Whether the task is offered to proven providers only, while there is one.
function isForProven(Passed passed) pure returns (bool) {
    return Passed.unwrap(passed) >> (32 * (PROVEN_FROM - 1)) != 0;
}

/// @notice Whether the task ends.
function isFull(Passed passed) pure returns (bool) {
    return Passed.unwrap(passed) >> (32 * (MAX_PASSED - 1)) != 0;
}

/// @notice Whether one of them gave up after a proof.
function someoneGaveUp(Passed passed) pure returns (bool) {
    return Passed.unwrap(passed) & (type(uint256).max / type(uint32).max) != 0;
}
