// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Hire} from "../interfaces/IServiceManager.sol";
import {TaskState} from "../interfaces/ITaskManager.sol";
import {KindId} from "../types/KindId.sol";
import {ServiceId, unpackService} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";

/// @dev A task in memory: read once in a transaction, and written after each change. See TaskRecords.
/// @param reward has 88 bits in storage, enough for what any service may cost (Units.max)
/// @param price a multiple of the unit of prices, at most Units.max
/// @param serviceId of the running (or last) attempt; while a task is open, the service that it names, or one of the
/// provider that it names, or 0
/// @param time has 32 bits in storage: until 2106. The end of the execution window while the task is Assigned; when the proof
/// came while it is Submitted or Ruled; when it was queued again while it is Open; else 0, or one of these of a task that is over
/// @param accepted the executor agreed to the running attempt, so that its failure costs the executor something
/// @param attempt the running (or last) one, 1 for the first
/// @param conditions the first task that had the creator's conditions, which are the members below
/// @param executionWindow has 24 bits in storage, and so has `verdictWindow`
/// @param auditWindow how much longer than the verdict window a ruling can be replaced, in 24 bits, too; as the kind had it
/// when the task was posted
/// @param grace how long its executor may give it back, s: a multiple of GRACE_STEP, in 8 bits; as the kind had it
/// @param hired only `serviceId`, or only its provider, may do the task, because its creator named it
struct Record {
    uint256 reward;
    uint256 price;
    ServiceId serviceId;
    uint256 time;
    TaskState state;
    bool accepted;
    uint8 attempt;
    uint32 conditions;
    address creator;
    uint32 executionWindow;
    uint32 verdictWindow;
    uint32 auditWindow;
    KindId kindId;
    uint8 maxAttempts;
    Hire hired;
    uint32 grace;
}

/// @title Tasks in few words of storage: one for each task, and one for the conditions that tasks of one creator share.
library TaskRecords {
    /// @dev What grace periods are multiples of, s.
    uint32 internal constant GRACE_STEP = 10;

    struct Store {
        mapping(TaskId taskId => uint256) tasks;
        mapping(uint32 first => uint256) conditions;
        /// @dev The first task that had these conditions, where they are kept. A hash of them as their place would be
        /// cheaper once, but strangers could fill the places behind it, and each task would pay for looking there.
        mapping(uint256 conditions => uint32 first) firsts;
    }

    /// @notice Read a task into `t`, which stays as it is, in the state None, if there is none. Not returned, because memory
    /// would be made for it a second time, by whoever calls.
    /// @param unit of prices, see Units.unitOf
    function load(Store storage store, TaskId taskId, uint256 unit, Record memory t) internal view {
        uint256 word = store.tasks[taskId];
        if (word == 0) return;
        t.reward = word >> 168;
        t.price = uint256(uint64(word >> 104)) * unit;
        t.serviceId = unpackService(uint32(word >> 72));
        t.time = uint32(word >> 40);
        t.conditions = uint32(word >> 8);
        t.attempt = uint8(word >> 4) & 15;
        t.accepted = word & 8 != 0;
        t.state = TaskState(word & 7);
    }

    /// @notice Read its conditions into `t`, too. Not with the rest, because some steps in the life of a task need none.
    function loadConditions(Store storage store, Record memory t) internal view {
        uint256 wanted = store.conditions[t.conditions];
        t.creator = address(uint160(wanted >> 96));
        t.executionWindow = uint24(wanted >> 72);
        t.verdictWindow = uint24(wanted >> 48);
        t.auditWindow = uint24(wanted >> 24);
        t.kindId = KindId.wrap(uint8(wanted >> 16));
        t.maxAttempts = uint8(wanted >> 12) & 15;
        t.hired = Hire(uint8(wanted >> 8) & 3);
        t.grace = uint8(wanted) * GRACE_STEP;
    }

    /// @notice Write what changes in the life of a task.
    function save(Store storage store, TaskId taskId, Record memory t, uint256 unit) internal {
        uint256 progress = uint256(t.attempt) << 4 | (t.accepted ? 8 : 0) | uint256(t.state);
        uint256 place = uint256(t.serviceId.pack()) << 72 | t.time << 40 | uint256(t.conditions) << 8;
        store.tasks[taskId] = t.reward << 168 | (t.price / unit) << 104 | place | progress;
    }

    /// @notice Keep the conditions of a new task, unless an earlier one had them, and note which did.
    function keepConditions(Store storage store, TaskId taskId, Record memory t) internal {
        uint256 windows =
            uint256(t.executionWindow) << 72 | uint256(t.verdictWindow) << 48 | uint256(t.auditWindow) << 24;
        uint256 rest = uint256(KindId.unwrap(t.kindId)) << 16 | uint256(t.maxAttempts) << 12
            | uint256(t.hired) << 8 | t.grace / GRACE_STEP;
        uint256 wanted = uint256(uint160(t.creator)) << 96 | windows | rest;
        t.conditions = store.firsts[wanted];
        if (t.conditions != 0) return;
        t.conditions = taskId.packConditions();
        (store.firsts[wanted], store.conditions[t.conditions]) = (t.conditions, wanted);
    }
}
