// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Service, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {Cause, ITaskManager, TaskRequest, TaskState, Ruling} from "../src/interfaces/ITaskManager.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";
import {Possession} from "./Possession.sol";

/// @notice Tasks that nobody can do: what they cost, and whom.
contract ImpossibleTest is Fixture {
    function setUp() public override {
        super.setUp();
        for (uint256 i = 0; i < 2; ++i) {
            address robot = i == 0 ? robot2 : robot3;
            vm.prank(bob);
            coin.transfer(robot, 100 ether);
            vm.prank(robot);
            coin.approve(address(tasks), type(uint256).max);
        }
        setTerms(50 ether, 25 ether, 2);
    }

    function test_anImpossibleTaskTakesNobodysBond() public {
        ServiceId[3] memory offered =
            [_offerByHand(robot1, 80 ether), _offerByHand(robot2, 80 ether), _offerByHand(robot3, 80 ether)];
        for (uint256 i = 0; i < 2; ++i) {
            TaskId taskId = post(alice, 100 ether);
            for (uint256 n = 0; n < 3; ++n) {
                vm.warp(tasks.task(taskId).deadline + 1);
                tasks.expireTask(taskId);
            }
            assertState(taskId, TaskState.Open);
        }
        for (uint256 i = 0; i < 3; ++i) {
            Service memory s = services.service(offered[i]);
            assertEq(s.bond, 50 ether, "the bond");
            assertEq(s.failures, 0, "failures");
            assertEq(s.expired, 0, "the record");
            assertEq(uint8(s.state), uint8(ServiceState.Active));
        }
    }

    function test_whoHasNotAcceptedGivesWayAfterAQuarterOfTheWindow() public {
        _offerByHand(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        ServiceId next = _offerByHand(robot2, 80 ether);
        uint256 graceEnd = block.timestamp + WINDOW / 4;
        vm.warp(graceEnd);
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.DeadlineNotPassed.selector, taskId, graceEnd, graceEnd)
        );
        tasks.expireTask(taskId);
        vm.warp(graceEnd + 1);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskRequeued(taskId, 1, Cause.NotAccepted);
        tasks.expireTask(taskId);
        assertAssigned(taskId, next);
        assertFalse(tasks.task(taskId).accepted);
    }

    function test_whoAcceptsAnswersForIt() public {
        ServiceId serviceId = _offerByHand(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskAccepted(taskId, 1, robot1);
        vm.startPrank(robot1);
        tasks.acceptTask(taskId, 1);
        assertTrue(tasks.task(taskId).accepted);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.AlreadyAccepted.selector, taskId, 1));
        tasks.acceptTask(taskId, 1);
        vm.stopPrank();
        vm.warp(block.timestamp + WINDOW + 1);
        tasks.expireTask(taskId);
        assertEq(services.service(serviceId).bond, 25 ether);
        assertEq(services.service(serviceId).expired, 1);
    }

    function test_theNextAttemptIsNotAcceptedBefore() public {
        _offerByHand(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.prank(robot1);
        tasks.acceptTask(taskId, 1);
        _offerByHand(robot2, 80 ether);
        vm.prank(robot1);
        tasks.abandonTask(taskId, 1);
        assertFalse(tasks.task(taskId).accepted);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotExecutor.selector, taskId, robot1, robot2));
        vm.prank(robot1);
        tasks.acceptTask(taskId, 2);
    }

    function test_aServiceThatAcceptsEachTaskAbandonsEarlyAtNoCost() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.warp(block.timestamp + WINDOW / 4);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskRequeued(taskId, 1, Cause.Abandoned);
        vm.prank(robot1);
        tasks.abandonTask(taskId, 1);
        assertEq(services.service(serviceId).bond, 50 ether);
        assertEq(services.service(serviceId).failures, 0);
        assertEq(services.service(serviceId).expired, 0);
    }

    function test_whoAbandonsLateAnswersForIt() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.warp(block.timestamp + WINDOW / 4 + 1);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskRequeued(taskId, 1, Cause.AbandonedLate);
        vm.prank(robot1);
        tasks.abandonTask(taskId, 1);
        assertEq(services.service(serviceId).bond, 25 ether);
        assertEq(services.service(serviceId).expired, 1);
    }

    function test_onlyTheExecutorAbandonsAndOnlyWhatItDoes() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotExecutor.selector, taskId, alice, robot1));
        vm.prank(alice);
        tasks.abandonTask(taskId, 1);
        submit(taskId);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, taskId, TaskState.Submitted, TaskState.Assigned
            )
        );
        vm.prank(robot1);
        tasks.abandonTask(taskId, 1);
    }

    function test_attack_impossibleTasksThatARobotAbandonsDoNotPutItToSleep() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        for (uint256 i = 0; i < 3; ++i) {
            TaskId taskId = post(alice, 100 ether);
            _abandon(robot1, taskId);
            assertState(taskId, TaskState.Open);
        }
        assertEq(providers.asleepUntil(robot1), 0);
        assertAssigned(post(bob, 100 ether), serviceId);
    }

    /// @dev Accepted, each costs the penalty and stands in the record; not accepted, nothing. No give-back is a miss.
    function test_attack_tasksGivenBackLatePutNoProvenProviderToSleep() public {
        for (uint256 i = 0; i < 2; ++i) {
            bool accepts = i == 1;
            setUp();
            setTerms(50 ether, 5 ether, 0);
            ServiceId serviceId = accepts ? offer(robot1, 80 ether) : _offerByHand(robot1, 80 ether);
            for (uint8 n = 1; n <= ATTEMPTS; ++n) {
                // One that counts comes to the same service again.
                TaskId taskId = accepts && n != 1 ? taskNo(1) : post(alice, 100 ether);
                vm.warp(tasks.task(taskId).deadline);
                vm.expectEmit(address(tasks));
                if (!accepts) emit ITaskManager.TaskRequeued(taskId, 1, Cause.Abandoned);
                else if (n < ATTEMPTS) emit ITaskManager.TaskRequeued(taskId, n, Cause.AbandonedLate);
                else emit ITaskManager.TaskFailed(taskId, 100 ether, n, Cause.AbandonedLate);
                _abandon(robot1, taskId);
            }
            assertEq(providers.asleepUntil(robot1), 0);
            Service memory s = services.service(serviceId);
            assertEq(s.failures, accepts ? ATTEMPTS : 0);
            assertEq(s.expired, accepts ? ATTEMPTS : 0);
            assertEq(s.bond, accepts ? 35 ether : 50 ether);
            assertEq(s.reputation < 32, accepts);
            assertAssigned(post(bob, 100 ether), serviceId);
        }
    }

    function test_attack_onesOwnTasksForgiveNothing() public {
        setTerms(0, 0, 0);
        ServiceId serviceId = offer(robot1, 80 ether);
        vm.prank(admin);
        Possession.register(organization, robot1, "robot", bob, "robot1");
        TaskId taskId = post(alice, 100 ether);
        for (uint256 n = 0; n < ATTEMPTS; ++n) {
            attempt(taskId, false);
        }
        address[2] memory own = [robot1, bob];
        for (uint256 i = 0; i < own.length; ++i) {
            taskId = post(own[i], 100 ether);
            attempt(taskId, true);
            assertEq(services.service(serviceId).failures, ATTEMPTS, "accepted");
        }
        attempt(post(alice, 100 ether), true);
        assertEq(services.service(serviceId).failures, 0);
    }

    function test_attack_onesOwnTasksDoNotWake() public {
        setTerms(0, 0, 0);
        offer(robot1, 80 ether);
        ServiceId other = offer(robot1, 80 ether);
        TaskRequest memory r = request(100 ether);
        r.executionWindow = 1 days;
        vm.prank(robot1);
        TaskId own = tasks.registerTask(r);
        TaskId taskId = post(alice, 100 ether);
        assertAssigned(taskId, other);
        while (state(taskId) == TaskState.Assigned) {
            vm.warp(tasks.task(taskId).deadline + 1);
            tasks.expireTask(taskId);
        }
        uint256 until = providers.asleepUntil(robot1);
        assertGt(until, 0);
        attempt(own, true);
        assertEq(providers.asleepUntil(robot1), until);
    }

    function _abandon(address provider, TaskId taskId) private {
        uint8 running = tasks.task(taskId).attempt;
        vm.prank(provider);
        tasks.abandonTask(taskId, running);
    }

    function test_anImpossibleTaskPaysItsExecutorATenthAndEnds() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskSettled(taskId, robot1, 8 ether, 92 ether);
        judgeAs(oracle, taskId, Ruling.Impossible, 0);
        assertState(taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), 1958 ether, "2000, less the bond");
        assertEq(coin.balanceOf(alice), 1992 ether);
        Service memory s = services.service(serviceId);
        assertEq(s.completed + s.rejected + s.expired, 0, "the record");
        assertEq(s.bond, 50 ether);
    }

    function test_auditorsFindATaskImpossible() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        judgeAs(oracle, taskId, Ruling.None, 0);
        judgeAs(auditor, taskId, Ruling.Impossible, 0);
        assertState(taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), 1958 ether);
        assertEq(coin.balanceOf(alice), 1992 ether);
    }

    function test_theOrganizationAcceptsAndAbandonsByItsOperator() public {
        vm.startPrank(admin);
        organization.registerService(CLEANING, 80 ether, NO_LIMIT, false, "");
        vm.stopPrank();
        TaskId taskId = post(alice, 100 ether);
        vm.startPrank(admin);
        organization.acceptTask(taskId, 1);
        assertTrue(tasks.task(taskId).accepted);
        organization.abandonTask(taskId, 1);
        vm.stopPrank();
        assertState(taskId, TaskState.Open);
    }

    function _offerByHand(address provider, uint256 price) private returns (ServiceId serviceId) {
        vm.prank(provider);
        return services.registerService(CLEANING, price, NO_LIMIT, false, "");
    }
}
