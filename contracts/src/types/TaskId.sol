// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @notice The number of a task, counted from 1.
type TaskId is uint256;

/// @dev No task has this number.
TaskId constant NO_TASK = TaskId.wrap(0);

using {equal as ==, differ as !=, before as <, pack, packConditions} for TaskId global;

function equal(TaskId a, TaskId b) pure returns (bool) {
    return TaskId.unwrap(a) == TaskId.unwrap(b);
}

function differ(TaskId a, TaskId b) pure returns (bool) {
    return TaskId.unwrap(a) != TaskId.unwrap(b);
}

/// @dev Numbers grow with time: the task with the lower one was posted earlier.
function before(TaskId a, TaskId b) pure returns (bool) {
    return TaskId.unwrap(a) < TaskId.unwrap(b);
}

/// @dev As it is stored beside other values, and as a key of a WeightTree. TaskManager counts in 40 bits.
function pack(TaskId id) pure returns (uint40) {
    return uint40(TaskId.unwrap(id));
}

/// @dev As it is stored where it stands for the conditions of many tasks. So many creators with conditions of their own
/// there will not be.
function packConditions(TaskId id) pure returns (uint32) {
    assert(TaskId.unwrap(id) <= type(uint32).max);
    return uint32(TaskId.unwrap(id));
}

/// @dev What `pack` has packed.
function unpackTask(uint64 packed) pure returns (TaskId) {
    return TaskId.wrap(packed);
}
