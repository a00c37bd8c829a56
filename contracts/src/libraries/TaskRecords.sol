// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Hire, Silence, TaskState} from "../interfaces/ITaskManager.sol";
import {Units} from "./Units.sol";

/// @notice What a creator wants of a task, but for the reward, in one word. Tasks of one creator mostly want the same,
/// so that they share it.
type Conditions is uint256;

using {creator, executionWindow, verdictWindow, kindId, maxAttempts, silence, hired} for Conditions global;

/// @dev A task in one word.
/// @param reward enough for what any service may cost, see Units.MAX
/// @param units the price in Units.UNIT
/// @param serviceId of the running (or last) attempt; while a task is open, the service that it names, or one of
/// the provider that it names, or 0
/// @param deadline until 2106
/// @param conditions where they are kept
/// @param progress state (3 bits), whether the executor agreed to the running attempt, so that its failure costs it
/// something (1 bit), and the number of that attempt (4 bits)
struct Record {
    uint88 reward;
    uint64 units;
    uint32 serviceId;
    uint32 deadline;
    uint32 conditions;
    uint8 progress;
}

using TaskRecords for Record global;

/// @notice Who posted the task.
function creator(Conditions c) pure returns (address) {
    return address(uint160(Conditions.unwrap(c) >> 96));
}

/// @notice Seconds from assignment to proof.
function executionWindow(Conditions c) pure returns (uint32) {
    return uint24(Conditions.unwrap(c) >> 72);
}

/// @notice Seconds from proof to verdict.
function verdictWindow(Conditions c) pure returns (uint32) {
    return uint24(Conditions.unwrap(c) >> 48);
}

/// @notice The number of the kind.
function kindId(Conditions c) pure returns (uint8) {
    return uint8(Conditions.unwrap(c) >> 40);
}

/// @notice How many assignments before the reward goes back.
function maxAttempts(Conditions c) pure returns (uint8) {
    return uint8(Conditions.unwrap(c) >> 32);
}

/// @notice Who wins a proof that nobody judges, as the kind had it when the task was posted.
function silence(Conditions c) pure returns (Silence) {
    return Silence(uint8(Conditions.unwrap(c) >> 24));
}

/// @notice Whom the creator named.
function hired(Conditions c) pure returns (Hire) {
    return Hire(uint8(Conditions.unwrap(c)));
}

/// @title What a task is, in few words of storage.
library TaskRecords {
    uint8 private constant STATE = 7;
    uint8 private constant ACCEPTED = 8;

    /// @notice Returns the conditions in one word.
    /// @param creator_ who posts the task; not 0
    /// @param executionWindow_ at most 24 bits
    /// @param verdictWindow_ at most 24 bits
    function pack(
        address creator_,
        uint256 executionWindow_,
        uint256 verdictWindow_,
        uint8 kindId_,
        uint8 maxAttempts_,
        Silence silence_,
        Hire hired_
    ) internal pure returns (Conditions) {
        uint256 windows = executionWindow_ << 72 | verdictWindow_ << 48;
        uint256 rest = uint256(kindId_) << 40 | uint256(maxAttempts_) << 32 | uint256(silence_) << 24;
        return Conditions.wrap(uint256(uint160(creator_)) << 96 | windows | rest | uint256(hired_));
    }

    /// @notice Returns where the conditions are kept, and keeps them there if they are new.
    /// @dev Who wants a place that others' conditions have takes the next. To make somebody's new conditions cost one
    /// more word to look up takes a hash of 32 given bits and a task of one's own; old ones keep their place.
    function keep(mapping(uint32 key => Conditions) storage all, Conditions c) internal returns (uint32 key) {
        uint256 wanted = Conditions.unwrap(c);
        key = uint32(uint256(keccak256(abi.encode(wanted))));
        while (true) {
            uint256 kept = Conditions.unwrap(all[key]);
            if (kept == wanted) return key;
            if (kept == 0) {
                all[key] = c;
                return key;
            }
            unchecked {
                ++key;
            }
        }
    }

    /// @notice Returns where the task stands.
    function state(Record storage t) internal view returns (TaskState) {
        return TaskState(t.progress & STATE);
    }

    /// @notice Returns whether the executor agreed to the running (or last) attempt.
    function accepted(Record storage t) internal view returns (bool) {
        return t.progress & ACCEPTED != 0;
    }

    /// @notice Returns the number of the running (or last) attempt, 1 for the first.
    function attempt(Record storage t) internal view returns (uint8) {
        return t.progress >> 4;
    }

    /// @notice Returns what the executor is paid at most, in the token's smallest unit.
    function price(Record storage t) internal view returns (uint256) {
        return uint256(t.units) * Units.UNIT;
    }

    /// @notice The task is in another state.
    function enter(Record storage t, TaskState next) internal {
        t.progress = (t.progress & ~STATE) | uint8(next);
    }

    /// @notice The executor agrees to the running attempt.
    function accept(Record storage t) internal {
        t.progress |= ACCEPTED;
    }

    /// @notice A service begins with the next attempt.
    /// @param price_ a multiple of Units.UNIT, at most Units.MAX
    function assign(Record storage t, uint256 serviceId, uint256 price_, uint32 deadline, bool accepted_)
        internal
    {
        t.units = uint64(price_ / Units.UNIT);
        t.serviceId = uint32(serviceId);
        t.deadline = deadline;
        uint8 number = attempt(t) + 1;
        t.progress = number << 4 | (accepted_ ? ACCEPTED : 0) | uint8(TaskState.Assigned);
    }
}
