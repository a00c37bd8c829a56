// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {SafeCast} from "@openzeppelin/contracts/utils/math/SafeCast.sol";
import {IOrganization} from "../src/interfaces/IOrganization.sol";
import {IMatchingPolicy} from "../src/interfaces/IMatchingPolicy.sol";
import {Hire, Task, TaskRequest, TaskState} from "../src/interfaces/ITaskManager.sol";
import {Record, TaskRecords} from "../src/libraries/TaskRecords.sol";
import {KindId} from "../src/types/KindId.sol";
import {GUARDIAN_ROLE} from "../src/types/Roles.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";

/// @notice Tasks in one word, and kinds as small numbers.
contract TaskRecordsTest is Fixture {
    using TaskRecords for TaskRecords.Store;

    uint256 private constant UNIT = 1 gwei;

    TaskRecords.Store private _store;

    function testFuzz_aTaskIsReadAsItWasWritten(
        address creator,
        uint88 reward,
        uint64 units,
        uint32[3] calldata numbers,
        uint8[5] calldata bytes_,
        bool accepted
    ) public {
        vm.assume(creator != address(0));
        Record memory t;
        (t.creator, t.reward, t.price) = (creator, reward, uint256(units) * UNIT);
        (t.serviceId, t.time, t.executionWindow) = (serviceNo(numbers[0]), numbers[1], numbers[2] >> 8);
        (t.verdictWindow, t.kindId, t.maxAttempts) =
        (uint24(numbers[1]), KindId.wrap(bytes_[0]), bytes_[1] & 15);
        (t.attempt, t.state, t.accepted) = (bytes_[2] & 15, TaskState(1 + bytes_[3] % 7), accepted);
        t.hired = Hire(bytes_[3] % 3);
        t.auditWindow = uint24(numbers[2]);
        _store.keepConditions(taskNo(7), t);
        _store.save(taskNo(7), t, UNIT);
        Record memory read;
        _store.load(taskNo(7), UNIT, read);
        _store.loadConditions(read);
        assertEq(keccak256(abi.encode(read)), keccak256(abi.encode(t)));
        Record memory none;
        _store.load(taskNo(8), UNIT, none);
        assertEq(uint8(none.state), uint8(TaskState.None));
    }

    function test_tasksShareTheConditionsOfTheFirstThatHadThem() public {
        Record memory one;
        (one.creator, one.executionWindow) = (alice, 1);
        _store.keepConditions(taskNo(3), one);
        assertEq(one.conditions, 3);
        Record memory other;
        (other.creator, other.executionWindow) = (bob, 1);
        _store.keepConditions(taskNo(4), other);
        assertEq(other.conditions, 4);
        _store.keepConditions(taskNo(5), one);
        assertEq(one.conditions, 3);
        assertEq(_store.conditions[5], 0);
    }

    /// @dev However many tasks with other conditions strangers post first.
    function test_strangersTasksDoNotMakeConditionsDearer() public {
        uint256 alone = _costOfKeeping(taskNo(1), alice);
        for (uint160 i = 1; i <= 200; ++i) {
            Record memory t;
            t.creator = address(i);
            _store.keepConditions(taskNo(1 + i), t);
        }
        assertEq(_costOfKeeping(taskNo(300), bob), alone);
    }

    function test_tasksOfDifferentConditionsAreApart() public {
        TaskId first = post(alice, 100 ether);
        TaskId second = post(bob, 90 ether);
        TaskRequest memory r = request(80 ether);
        (r.executionWindow, r.maxAttempts) = (2 hours, 1);
        vm.prank(alice);
        TaskId third = tasks.registerTask(r);
        assertEq(tasks.task(first).creator, alice);
        assertEq(tasks.task(second).creator, bob);
        assertEq(tasks.task(first).maxAttempts, ATTEMPTS);
        Task memory t = tasks.task(third);
        assertEq(t.creator, alice);
        assertEq(t.reward, 80 ether);
        assertEq(t.executionWindow, 2 hours);
        assertEq(t.maxAttempts, 1);
        assertEq(uint8(t.state), uint8(TaskState.Open));
    }

    function test_aRewardIsAtMostWhatItsBitsHold() public {
        TaskRequest memory r = request(1 << 88);
        vm.prank(alice);
        vm.expectRevert(
            abi.encodeWithSelector(SafeCast.SafeCastOverflowedUintDowncast.selector, 88, uint256(1 << 88))
        );
        tasks.registerTask(r);
    }

    function test_nobodyHasToAskWhoeverChoosesTheLongestIdle() public {
        assertFalse(_asks());
        vm.prank(admin);
        organization.setPolicy(IMatchingPolicy(deployed("LowestPrice")));
        assertTrue(_asks());
        IMatchingPolicy first = IMatchingPolicy(deployed("FirstComeFirstServed"));
        vm.prank(admin);
        organization.setPolicy(first);
        assertFalse(_asks());
        assertEq(address(organization.policy()), address(first));
    }

    /// @dev What new tasks look up stands with the task manager, and follows each change at once.
    function test_tasksAreRestrictedWhileTheOrganizationSaysSo() public {
        vm.prank(admin);
        organization.grantRole(GUARDIAN_ROLE, admin);
        TaskRequest memory r = request(1 ether);
        vm.prank(admin);
        organization.pauseTasks(1 hours);
        vm.prank(alice);
        vm.expectPartialRevert(IOrganization.TasksArePaused.selector);
        tasks.registerTask(r);
        vm.warp(block.timestamp + 1 hours);
        vm.prank(alice);
        tasks.registerTask(r);
        tasks.updateAdmission();
        vm.prank(alice);
        tasks.registerTask(r);
        vm.prank(admin);
        organization.setMembersOnly(true);
        vm.prank(alice);
        vm.expectRevert(abi.encodeWithSelector(IOrganization.NotMember.selector, alice));
        tasks.registerTask(r);
        tasks.updateAdmission();
        vm.prank(alice);
        vm.expectRevert(abi.encodeWithSelector(IOrganization.NotMember.selector, alice));
        tasks.registerTask(r);
        vm.prank(admin);
        organization.setMembersOnly(false);
        vm.prank(alice);
        tasks.registerTask(r);
    }

    function test_kindsAreNumbered() public {
        assertEq(organization.numberOf(CLEANING), 1);
        assertEq(organization.kindNumbered(KindId.wrap(2)), CHARGING);
        assertEq(organization.numberOf("painting"), 0);
        assertEq(organization.kindNumbered(KindId.wrap(3)), 0);
        assertEq(organization.kindOf(CHARGING).number, 2);
        vm.startPrank(admin);
        for (uint256 i = 3; i <= 255; ++i) {
            organization.setWindows(bytes32(i), windows(SHORTEST, 3 minutes), 1 ether);
            organization.allowKind(bytes32(i), oracleJudge, 0);
        }
        organization.allowKind(CLEANING, oracleJudge, RULES);
        assertEq(organization.numberOf(CLEANING), 1, "kept");
        organization.setWindows("one more", windows(SHORTEST, 3 minutes), 1 ether);
        vm.expectRevert(abi.encodeWithSelector(IOrganization.TooManyKinds.selector, bytes32("one more"), 255));
        organization.allowKind("one more", oracleJudge, 0);
    }

    function _costOfKeeping(TaskId taskId, address creator) private returns (uint256 gas) {
        Record memory t;
        t.creator = creator;
        gas = gasleft();
        _store.keepConditions(taskId, t);
        gas -= gasleft();
    }

    function _asks() private view returns (bool asks) {
        (asks,) = organization.admission();
    }
}
