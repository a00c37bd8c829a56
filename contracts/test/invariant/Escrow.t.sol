// SPDX-License-Identifier: MIT
pragma solidity ^0.8.28;

import {Service, ServiceState} from "../../src/interfaces/IServiceManager.sol";
import {Task, TaskState} from "../../src/interfaces/ITaskManager.sol";
import {Fixture} from "../Fixture.sol";
import {Handler} from "./Handler.sol";

contract EscrowInvariants is Fixture {
    Handler private _handler;
    address[] private _participants;

    function setUp() public override {
        super.setUp();
        address[] memory creators = new address[](3);
        (creators[0], creators[1], creators[2]) = (alice, bob, robot1);
        address[] memory providers = new address[](3);
        (providers[0], providers[1], providers[2]) = (robot1, robot2, robot3);
        _participants = [alice, bob, robot1, robot2, robot3];
        _handler = new Handler(coin, services, tasks, oracle, creators, providers);
        targetContract(address(_handler));
    }

    /// @notice The escrow holds the rewards of live tasks, no more and no less.
    function invariant_escrowEqualsLiveRewards() public view {
        uint256 live = 0;
        for (uint256 taskId = 1; taskId <= tasks.taskCount(); ++taskId) {
            if (_isLive(taskId)) live += tasks.task(taskId).reward;
        }
        assertEq(coin.balanceOf(address(tasks)), live);
    }

    /// @notice Everyone owns what its own calls and the rules say.
    function invariant_nobodyGainsOrLosesOtherwise() public view {
        for (uint256 i = 0; i < _participants.length; ++i) {
            assertEq(coin.balanceOf(_participants[i]), _handler.expected(_participants[i]));
        }
    }

    /// @notice A running task has a service that does just this task, and a busy service a task that runs.
    function invariant_runningTasksAndBusyServicesArePairs() public view {
        for (uint256 taskId = 1; taskId <= tasks.taskCount(); ++taskId) {
            if (_isRunning(taskId)) {
                assertEq(services.service(tasks.task(taskId).serviceId).taskId, taskId);
            }
        }
        for (uint256 serviceId = 1; serviceId <= services.serviceCount(); ++serviceId) {
            uint256 taskId = services.service(serviceId).taskId;
            if (taskId == 0) continue;
            assertTrue(_isRunning(taskId));
            assertEq(tasks.task(taskId).serviceId, serviceId);
        }
    }

    /// @notice Nobody waits for what is there: no open task can be done by a service that waits.
    function invariant_nothingWaitsThatCouldRun() public view {
        for (uint256 serviceId = 1; serviceId <= services.serviceCount(); ++serviceId) {
            Service memory s = services.service(serviceId);
            bool available = s.state == ServiceState.Active && s.taskId == 0;
            assertEq(s.place != 0, available, "waits exactly when available");
            if (available) assertEq(tasks.oldestOpen(CLEANING, s.price), 0);
        }
    }

    /// @notice What waits can be found, and the oldest comes first.
    function invariant_theOldestOpenTaskIsNext() public view {
        uint256 oldest = 0;
        for (uint256 taskId = 1; taskId <= tasks.taskCount() && oldest == 0; ++taskId) {
            if (state(taskId) == TaskState.Open) oldest = taskId;
        }
        assertEq(tasks.oldestOpen(CLEANING, 0), oldest);
    }

    function _isRunning(uint256 taskId) private view returns (bool) {
        TaskState current = state(taskId);
        return current == TaskState.Assigned || current == TaskState.Submitted;
    }

    function _isLive(uint256 taskId) private view returns (bool) {
        return state(taskId) == TaskState.Open || _isRunning(taskId);
    }
}
