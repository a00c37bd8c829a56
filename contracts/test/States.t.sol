// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ITaskManager, Fault, Ruling, Task, TaskState} from "../src/interfaces/ITaskManager.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";

/// @notice Every ruling meets a task in every state, once final and once until the case ends: 8 states, 6 rulings, 96 calls of
/// the kind's judge. One table says what the task is afterwards.
contract StatesTest is Fixture {
    uint256 private constant REWARD = 40 ether;
    uint256 private constant PRICE = 30 ether;

    TaskId private _task;

    function setUp() public override {
        super.setUp();
        setTerms(20 ether, 5 ether, 0);
        offer(robot1, PRICE);
    }

    function test_none() public {
        _meets(TaskState.None);
    }

    function test_open() public {
        _meets(TaskState.Open);
    }

    function test_assigned() public {
        _meets(TaskState.Assigned);
    }

    function test_submitted() public {
        _meets(TaskState.Submitted);
    }

    function test_ruled() public {
        _meets(TaskState.Ruled);
    }

    function test_settled() public {
        _meets(TaskState.Settled);
    }

    function test_cancelled() public {
        _meets(TaskState.Cancelled);
    }

    function test_failed() public {
        _meets(TaskState.Failed);
    }

    /// @dev What the task is after a ruling that is final, and after one that stands; None where the ruling is refused. No robot
    /// but the executor offers the work, and the attempt was the first of three.
    function _after(TaskState current, Ruling ruling)
        private
        pure
        returns (TaskState last, TaskState standing)
    {
        if (current != TaskState.Submitted && current != TaskState.Ruled) {
            return (TaskState.None, TaskState.None);
        }
        TaskState[6] memory ends = [
            TaskState.None,
            TaskState.Settled, // Accepted
            TaskState.Assigned, // Rejected
            TaskState.Open, // GivenUp
            TaskState.Settled, // Impossible
            TaskState.Failed // Void
        ];
        last = ends[uint8(ruling)];
        standing = ruling == Ruling.None ? TaskState.None : TaskState.Ruled;
    }

    function _meets(TaskState current) private {
        _reach(current);
        for (uint8 ruling = 0; ruling <= uint8(type(Ruling).max); ++ruling) {
            (TaskState last, TaskState standing) = _after(current, Ruling(ruling));
            _rule(current, Ruling(ruling), 0, last);
            _rule(current, Ruling(ruling), block.timestamp + 1 hours, standing);
        }
    }

    /// @dev A task of alice's that robot1 was given, in this state.
    function _reach(TaskState wanted) private {
        if (wanted == TaskState.None) {
            _task = taskNo(1);
            return;
        }
        bool waits = wanted == TaskState.Open || wanted == TaskState.Cancelled;
        _task = post(alice, waits ? PRICE / 2 : REWARD);
        if (wanted == TaskState.Cancelled) {
            vm.prank(alice);
            tasks.cancelTask(_task);
        }
        if (wanted > TaskState.Assigned && !waits) submit(_task);
        if (wanted == TaskState.Ruled) {
            ruleUntil(oracleJudge, _task, Ruling.Void, 0, block.timestamp + 2 hours);
        }
        if (wanted == TaskState.Settled) judge(_task, true);
        if (wanted == TaskState.Failed) judgeAs(oracle, _task, Ruling.Void, 0);
        assertState(_task, wanted);
    }

    /// @dev Nothing of a refused ruling stays, and nothing of one that is taken when this returns.
    function _rule(TaskState current, Ruling ruling, uint256 until, TaskState expected) private {
        uint256 snapshot = vm.snapshotState();
        if (expected == TaskState.None) vm.expectRevert(_refusal(current));
        vm.prank(address(oracleJudge));
        tasks.rule(
            _task,
            1,
            PROOF,
            ruling,
            Fault.Nobody,
            ruling == Ruling.Accepted ? uint96(PRICE) : 0,
            uint40(until),
            0
        );
        if (current != TaskState.None) assertState(_task, expected == TaskState.None ? current : expected);
        vm.revertToState(snapshot);
    }

    function _refusal(TaskState current) private view returns (bytes memory) {
        if (current == TaskState.None) {
            return abi.encodeWithSelector(ITaskManager.UnknownTask.selector, _task);
        }
        if (current == TaskState.Submitted || current == TaskState.Ruled) {
            return abi.encodeWithSelector(ITaskManager.NoRuling.selector, _task);
        }
        return abi.encodeWithSelector(ITaskManager.WrongState.selector, _task, current, TaskState.Submitted);
    }
}
