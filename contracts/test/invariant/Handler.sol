// SPDX-License-Identifier: MIT
pragma solidity ^0.8.28;

import {CommonBase} from "forge-std/Base.sol";
import {StdUtils} from "forge-std/StdUtils.sol";
import {IECoin} from "../../src/IECoin.sol";
import {ServiceManager} from "../../src/ServiceManager.sol";
import {TaskManager} from "../../src/TaskManager.sol";
import {Outcome, Service, ServiceState} from "../../src/interfaces/IServiceManager.sol";
import {Task, TaskRequest, TaskState} from "../../src/interfaces/ITaskManager.sol";

/// @notice Everything that anyone can do at any time, with bounded arguments, and what it should do to balances.
contract Handler is CommonBase, StdUtils {
    bytes32 private constant CLEANING = "waste_disposal";

    IECoin private immutable _coin;
    ServiceManager private immutable _services;
    TaskManager private immutable _tasks;
    address private immutable _oracle;
    address[] private _creators;
    address[] private _providers;

    /// @notice What each participant should own, from its own calls and the rules alone.
    mapping(address participant => uint256) public expected;

    constructor(
        IECoin coin,
        ServiceManager services,
        TaskManager tasks,
        address oracle,
        address[] memory creators,
        address[] memory providers
    ) {
        (_coin, _services, _tasks, _oracle) = (coin, services, tasks, oracle);
        (_creators, _providers) = (creators, providers);
        for (uint256 i = 0; i < creators.length; ++i) {
            expected[creators[i]] = coin.balanceOf(creators[i]);
        }
        for (uint256 i = 0; i < providers.length; ++i) {
            expected[providers[i]] = coin.balanceOf(providers[i]);
        }
    }

    function registerTask(uint256 who, uint256 reward, uint8 attempts) external {
        address creator = _creators[bound(who, 0, _creators.length - 1)];
        reward = bound(reward, 0, _min(expected[creator], 200 ether));
        attempts = uint8(bound(attempts, 1, 3));
        vm.prank(creator);
        _tasks.registerTask(TaskRequest(CLEANING, reward, 1 hours, 1 hours, attempts, "{}"));
        expected[creator] -= reward;
    }

    /// @dev Creators try at any time; the rules give the reward back only while the task is open.
    function cancelTask(uint256 which) external {
        uint256 taskId = _any(which);
        if (taskId == 0) return;
        Task memory t = _tasks.task(taskId);
        vm.prank(t.creator);
        try _tasks.cancelTask(taskId) {
            if (t.state == TaskState.Open) expected[t.creator] += t.reward;
        } catch {}
    }

    /// @dev Whoever is no party tries everything; the rules give it nothing.
    function meddle(uint256 which, address who) external {
        uint256 taskId = _any(which);
        if (taskId == 0 || _isParty(who)) return;
        Task memory t = _tasks.task(taskId);
        vm.startPrank(who);
        try _tasks.cancelTask(taskId) {} catch {}
        try _tasks.submitProof(taskId, t.attempt, "meddled", "") {} catch {}
        try _tasks.postVerdict(taskId, t.attempt, t.proofHash, true, 0, "", "") {} catch {}
        try _tasks.placeService(1, CLEANING, 0) {} catch {}
        try _services.release(1, Outcome.Completed) {} catch {}
        vm.stopPrank();
    }

    function registerService(uint256 who, uint256 price) external {
        if (_services.serviceCount() >= 12) return;
        vm.prank(_providers[bound(who, 0, _providers.length - 1)]);
        _services.registerService(CLEANING, bound(price, 0, 150) * 1 ether, "");
    }

    function updateService(uint256 which, uint256 price, uint8 state) external {
        uint256 services = _services.serviceCount();
        if (services == 0) return;
        uint256 serviceId = bound(which, 1, services);
        Service memory s = _services.service(serviceId);
        if (s.state == ServiceState.Retired) return;
        // One in ten retires, else there would soon be no service left.
        ServiceState next = state % 10 == 0 ? ServiceState.Retired : ServiceState(1 + state % 2);
        vm.prank(s.provider);
        _services.updateService(serviceId, bound(price, 0, 150) * 1 ether, next);
    }

    function submitProof(uint256 which, bytes32 proofHash) external {
        uint256 taskId = _find(which, TaskState.Assigned);
        if (taskId == 0 || proofHash == 0) return;
        Task memory t = _tasks.task(taskId);
        if (block.timestamp > t.deadline) return;
        vm.prank(_services.service(t.serviceId).provider);
        _tasks.submitProof(taskId, t.attempt, proofHash, "");
    }

    function postVerdict(uint256 which, bool accepted) external {
        uint256 taskId = _find(which, TaskState.Submitted);
        if (taskId == 0) return;
        Task memory t = _tasks.task(taskId);
        if (block.timestamp > t.deadline) return;
        address executor = _services.service(t.serviceId).provider;
        vm.prank(_oracle);
        _tasks.postVerdict(taskId, t.attempt, t.proofHash, accepted, 0, "", "");
        if (accepted) {
            expected[executor] += t.price;
            expected[t.creator] += t.reward - t.price;
        } else {
            _expectRefundAfterLast(t);
        }
    }

    function expireTask(uint256 which, bool submitted) external {
        uint256 taskId = _find(which, submitted ? TaskState.Submitted : TaskState.Assigned);
        if (taskId == 0) return;
        Task memory t = _tasks.task(taskId);
        if (block.timestamp <= t.deadline) return;
        _tasks.expireTask(taskId);
        _expectRefundAfterLast(t);
    }

    function wait(uint256 time) external {
        vm.warp(block.timestamp + bound(time, 1 minutes, 45 minutes));
    }

    function _expectRefundAfterLast(Task memory t) private {
        if (t.attempt == t.maxAttempts) expected[t.creator] += t.reward;
    }

    function _isParty(address who) private view returns (bool) {
        for (uint256 i = 0; i < _creators.length; ++i) {
            if (who == _creators[i]) return true;
        }
        for (uint256 i = 0; i < _providers.length; ++i) {
            if (who == _providers[i]) return true;
        }
        return who == _oracle || who == address(_tasks) || who == address(_services);
    }

    function _any(uint256 which) private view returns (uint256) {
        uint256 tasks = _tasks.taskCount();
        return tasks == 0 ? 0 : which % tasks + 1;
    }

    /// @dev Some task in `state`, searched from a random place; 0 if there is none.
    function _find(uint256 which, TaskState state) private view returns (uint256) {
        uint256 tasks = _tasks.taskCount();
        for (uint256 i = 0; i < tasks; ++i) {
            uint256 taskId = (which % tasks + i) % tasks + 1;
            if (_tasks.task(taskId).state == state) return taskId;
        }
        return 0;
    }

    function _min(uint256 a, uint256 b) private pure returns (uint256) {
        return a < b ? a : b;
    }
}
