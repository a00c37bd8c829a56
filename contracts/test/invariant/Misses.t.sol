// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ServiceState} from "../../src/interfaces/IServiceManager.sol";
import {Task, TaskRequest, TaskState} from "../../src/interfaces/ITaskManager.sol";
import {Fixture} from "../Fixture.sol";

/// @notice A provider hands in proofs or stays away, with either of two services.
contract MissesInvariants is Fixture {
    uint256[2] private _services;
    /// @dev Attempts without a proof since the last proof, or since it woke up.
    uint256 private _missed;
    bool private _wrong;

    function setUp() public override {
        super.setUp();
        _services = [offer(robot1, 1 gwei), offer(robot1, 1 gwei)];
        targetContract(address(this));
        bytes4[] memory actions = new bytes4[](1);
        actions[0] = this.work.selector;
        targetSelector(FuzzSelector(address(this), actions));
    }

    /// forge-config: default.invariant.runs = 4
    /// @notice A service falls asleep if, and only if, its provider missed MAX_MISSED attempts in a row.
    function invariant_whoMissesInARowFallsAsleepAndNobodyElse() public view {
        assertFalse(_wrong);
    }

    function work(bool comes) external {
        vm.prank(alice);
        uint256 taskId = tasks.registerTask(TaskRequest(CLEANING, 1 gwei, WINDOW, WINDOW, 1, 0, "{}"));
        if (state(taskId) == TaskState.Open) _wake();
        if (comes) {
            attempt(taskId, true);
            _missed = 0;
            return;
        }
        Task memory t = tasks.task(taskId);
        vm.warp(uint256(t.deadline) + 1);
        tasks.expireTask(taskId);
        bool due = ++_missed >= services.MAX_MISSED();
        if (due != (services.service(t.serviceId).state == ServiceState.Paused)) _wrong = true;
    }

    /// @dev Nobody took the task.
    function _wake() private {
        if (_missed < services.MAX_MISSED()) _wrong = true;
        for (uint256 i = 0; i < _services.length; ++i) {
            update(_services[i], 1 gwei, ServiceState.Active);
        }
        _missed = 0;
    }
}
