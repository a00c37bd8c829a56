// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {TaskId, unpackTask} from "./TaskId.sol";

/// @notice What changes of a service with each task, in one word, which is read and written once: the task that it does, or
/// its place in a line of those that wait for one, and how earlier ones ended.
/// From the lowest bit on: taskId (40 bits), completed (24), rejected (16), expired (16), previous (32), next (32),
/// place (40), line (24), proven (1), lineOfProven (1), number (30). Counters stop at their greatest value.
type Turn is uint256;

/// @dev Of a service that has done nothing yet.
Turn constant NO_TURN = Turn.wrap(0);

uint256 constant COMPLETED = 40;
uint256 constant REJECTED = 64;
uint256 constant EXPIRED = 80;
uint256 constant PREVIOUS = 96;
uint256 constant NEXT = 128;
uint256 constant PLACE = 160;
uint256 constant LINE = 200;
uint256 constant PROVEN = 224;
uint256 constant LINE_OF_PROVEN = 225;
uint256 constant NUMBER = 226;
/// @dev The greatest number of a service, and of a provider.
uint32 constant MAX_NUMBER = uint32((1 << 30) - 1);

using {
    taskId,
    completed,
    rejected,
    expired,
    previous,
    next,
    place,
    line,
    isProven,
    isLineOfProven,
    number,
    withTask,
    withCompleted,
    withRejected,
    withExpired,
    withPrevious,
    withNext,
    withPlace,
    withLine,
    withProven,
    withLineOfProven,
    withNumber
} for Turn global;

/// @notice The task that the service does; NO_TASK while it does none.
function taskId(Turn turn) pure returns (TaskId) {
    return unpackTask(uint40(Turn.unwrap(turn)));
}

/// @notice Attempts that were accepted.
function completed(Turn turn) pure returns (uint24) {
    return uint24(Turn.unwrap(turn) >> COMPLETED);
}

function rejected(Turn turn) pure returns (uint16) {
    return uint16(Turn.unwrap(turn) >> REJECTED);
}

function expired(Turn turn) pure returns (uint16) {
    return uint16(Turn.unwrap(turn) >> EXPIRED);
}

/// @notice Who waits before it in its line. Stale if nobody does.
function previous(Turn turn) pure returns (uint32) {
    return uint32(Turn.unwrap(turn) >> PREVIOUS);
}

/// @notice Who waits behind it; 0 for one of the latest of its line, who are in the line's word.
function next(Turn turn) pure returns (uint32) {
    return uint32(Turn.unwrap(turn) >> NEXT);
}

/// @notice Lower for who began to wait earlier; 0 while it does not wait.
function place(Turn turn) pure returns (uint40) {
    return uint40(Turn.unwrap(turn) >> PLACE);
}

/// @notice The key of the line in which it waits, or waited last, but always of its price: its provider's reputation may
/// change meanwhile.
function line(Turn turn) pure returns (uint24) {
    return uint24(Turn.unwrap(turn) >> LINE);
}

/// @notice Its provider is proven.
function isProven(Turn turn) pure returns (bool) {
    return Turn.unwrap(turn) >> PROVEN & 1 == 1;
}

/// @notice It waits, or waited last, among the services of proven providers. Its provider may have become one meanwhile.
function isLineOfProven(Turn turn) pure returns (bool) {
    return Turn.unwrap(turn) >> LINE_OF_PROVEN & 1 == 1;
}

/// @notice The number of its provider.
function number(Turn turn) pure returns (uint32) {
    return uint32(Turn.unwrap(turn) >> NUMBER);
}

function withTask(Turn turn, TaskId id) pure returns (Turn) {
    return _with(turn, 0, type(uint40).max, id.pack());
}

function withCompleted(Turn turn) pure returns (Turn) {
    return _counted(turn, COMPLETED, type(uint24).max);
}

function withRejected(Turn turn) pure returns (Turn) {
    return _counted(turn, REJECTED, type(uint16).max);
}

function withExpired(Turn turn) pure returns (Turn) {
    return _counted(turn, EXPIRED, type(uint16).max);
}

function withPrevious(Turn turn, uint32 id) pure returns (Turn) {
    return _with(turn, PREVIOUS, type(uint32).max, id);
}

function withNext(Turn turn, uint32 id) pure returns (Turn) {
    return _with(turn, NEXT, type(uint32).max, id);
}

function withPlace(Turn turn, uint40 place_) pure returns (Turn) {
    return _with(turn, PLACE, type(uint40).max, place_);
}

function withLine(Turn turn, uint24 key) pure returns (Turn) {
    return _with(turn, LINE, type(uint24).max, key);
}

function withProven(Turn turn, bool proven) pure returns (Turn) {
    return _with(turn, PROVEN, 1, proven ? 1 : 0);
}

function withLineOfProven(Turn turn, bool proven) pure returns (Turn) {
    return _with(turn, LINE_OF_PROVEN, 1, proven ? 1 : 0);
}

function withNumber(Turn turn, uint32 provider) pure returns (Turn) {
    return _with(turn, NUMBER, MAX_NUMBER, provider);
}

function _with(Turn turn, uint256 shift, uint256 mask, uint256 value) pure returns (Turn) {
    return Turn.wrap(Turn.unwrap(turn) & ~(mask << shift) | value << shift);
}

function _counted(Turn turn, uint256 shift, uint256 mask) pure returns (Turn) {
    uint256 word = Turn.unwrap(turn);
    return word >> shift & mask == mask ? turn : Turn.wrap(word + (1 << shift));
}
