// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IMatchingPolicy} from "../../src/interfaces/IMatchingPolicy.sol";
import {Kind, Review} from "../../src/interfaces/IOrganization.sol";
import {Service, ServiceState} from "../../src/interfaces/IServiceManager.sol";
import {Hire, Task, TaskState} from "../../src/interfaces/ITaskManager.sol";
import {HighestReputation} from "../../src/policies/HighestReputation.sol";
import {LowestPrice} from "../../src/policies/LowestPrice.sol";
import {SecondPrice} from "../../src/policies/SecondPrice.sol";
import {ServiceId} from "../../src/types/ServiceId.sol";
import {NO_TASK, TaskId} from "../../src/types/TaskId.sol";
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
        for (uint256 i = 1; i < 3; ++i) {
            vm.prank(bob);
            coin.transfer(providers[i], 500 ether);
            vm.prank(providers[i]);
            coin.approve(address(tasks), type(uint256).max);
        }
        IMatchingPolicy[] memory policies = new IMatchingPolicy[](4);
        (policies[0], policies[1]) = (policy, new LowestPrice());
        (policies[2], policies[3]) = (new HighestReputation(), new SecondPrice());
        _participants = [alice, bob, robot1, robot2, robot3, address(organization)];
        _handler = new Handler(coin, organization, admin, oracle, auditor, creators, providers, policies);
        // Whoever may not audit has the role all the same: what stops it is that it is a party, or has judged.
        address[5] memory others = [oracle, alice, robot1, robot2, robot3];
        (bytes32 role, bytes32 oracles) = (organization.AUDITOR_ROLE(), organization.ORACLE_ROLE());
        for (uint256 i = 0; i < others.length; ++i) {
            vm.prank(admin);
            organization.grantRole(role, others[i]);
            // The same for whoever signs a verdict on its own task.
            vm.prank(admin);
            organization.grantRole(oracles, others[i]);
        }
        vm.prank(admin);
        organization.setVerdictWindows(CLEANING, 15 minutes, 7 days);
        targetContract(address(_handler));
    }

    /// @notice The escrow holds the rewards of live tasks and the bonds, no more and no less: terminal tasks and
    /// services that have gone hold nothing.
    function invariant_escrowEqualsLiveRewardsAndBonds() public view {
        uint256 held = 0;
        for (TaskId taskId = taskNo(1); exists(taskId); taskId = following(taskId)) {
            if (_isLive(taskId)) held += tasks.task(taskId).reward;
        }
        for (ServiceId serviceId = serviceNo(1); exists(serviceId); serviceId = following(serviceId)) {
            held += services.service(serviceId).bond;
        }
        assertEq(coin.balanceOf(address(tasks)), held);
        assertEq(tasks.held(), held);
    }

    /// @notice Everyone owns what its own calls and the rules say.
    function invariant_nobodyGainsOrLosesOtherwise() public view {
        for (uint256 i = 0; i < _participants.length; ++i) {
            assertEq(coin.balanceOf(_participants[i]), _handler.expected(_participants[i]));
        }
    }

    /// @notice A running task has a service that does just this task, and a busy service a task that runs.
    function invariant_runningTasksAndBusyServicesArePairs() public view {
        for (TaskId taskId = taskNo(1); exists(taskId); taskId = following(taskId)) {
            if (_isRunning(taskId)) {
                assertEq(services.service(tasks.task(taskId).serviceId).taskId, taskId);
            }
        }
        for (ServiceId serviceId = serviceNo(1); exists(serviceId); serviceId = following(serviceId)) {
            TaskId taskId = services.service(serviceId).taskId;
            if (taskId == NO_TASK) continue;
            assertTrue(_isRunning(taskId));
            assertEq(tasks.task(taskId).serviceId, serviceId);
        }
    }

    /// @notice Nobody waits for what is there: no open task can be done by a service that waits.
    function invariant_nothingWaitsThatCouldRun() public view {
        for (ServiceId serviceId = serviceNo(1); exists(serviceId); serviceId = following(serviceId)) {
            Service memory s = services.service(serviceId);
            bool available = s.state == ServiceState.Active && s.taskId == NO_TASK;
            assertEq(s.place != 0, available, "waits exactly when available");
            if (available) assertEq(tasks.oldestOpen(CLEANING, s.price), 0);
        }
    }

    /// @notice No task waits for a service that it names, or for a service of the provider that it names, which is free.
    function invariant_nobodyWaitsForWhoIsFree() public view {
        for (TaskId taskId = taskNo(1); exists(taskId); taskId = following(taskId)) {
            Task memory t = tasks.task(taskId);
            if (t.state != TaskState.Open || t.hired == Hire.None) continue;
            for (ServiceId serviceId = serviceNo(1); exists(serviceId); serviceId = following(serviceId)) {
                Service memory s = services.service(serviceId);
                bool named = t.serviceId == serviceId || t.provider == s.provider;
                assertFalse(named && s.place != 0 && s.price <= t.reward, "it could do the task");
            }
        }
    }

    /// @notice What waits can be found, and the oldest comes first.
    function invariant_theOldestOpenTaskIsNext() public view {
        TaskId oldest = NO_TASK;
        for (TaskId taskId = taskNo(1); exists(taskId) && oldest == NO_TASK; taskId = following(taskId)) {
            if (state(taskId) == TaskState.Open && tasks.task(taskId).hired == Hire.None) oldest = taskId;
        }
        assertEq(tasks.oldestOpen(CLEANING, 0), oldest);
    }

    /// @notice Bonds, failures and suspensions are what the terms make of what happened.
    function invariant_everyServiceStandsWhereItsTermsPutIt() public view {
        for (ServiceId serviceId = serviceNo(1); exists(serviceId); serviceId = following(serviceId)) {
            Service memory s = services.service(serviceId);
            (uint256 bond,,, bool suspended,) = _handler.ghost(serviceId);
            assertEq(s.bond, bond, "bond");
            assertEq(s.state == ServiceState.Suspended, suspended, "suspended");
            assertEq(s.failures, _handler.failures(s.provider), "failures");
        }
    }

    /// @notice Who is asleep let attempts pass, or abandoned what others could do, since it last worked for others.
    function invariant_whoIsNotThereSleeps() public view {
        for (ServiceId serviceId = serviceNo(1); exists(serviceId); serviceId = following(serviceId)) {
            address provider = services.providerOf(serviceId);
            assertEq(services.asleepUntil(provider), _handler.asleepUntil(provider));
        }
    }

    /// @notice A provider is known for what it did for others, by value, whichever of its services did it; less so with
    /// time.
    function invariant_reputationIsWorkForOthersByValue() public view {
        for (ServiceId serviceId = serviceNo(1); exists(serviceId); serviceId = following(serviceId)) {
            Service memory s = services.service(serviceId);
            assertApproxEqAbs(s.reputation, _handler.reputation(s.provider), 1);
        }
    }

    /// @notice Tasks are posted under the rules that the administrator has named and not retired, and under no others;
    /// what an oracle judges always has some, and nobody looks through many.
    function invariant_theCurrentRulesAreThoseThatWereNamed() public view {
        bytes32[2] memory kinds = [CLEANING, CHARGING];
        for (uint256 i = 0; i < kinds.length; ++i) {
            bytes32[] memory current = organization.currentRules(kinds[i]);
            assertEq(current, _handler.expectedRules(kinds[i]));
            Kind memory k = organization.kindOf(kinds[i]);
            assertTrue(
                current.length != 0 || k.review != Review.Oracle || !k.allowed, "an oracle without rules"
            );
            assertLe(current.length, organization.MAX_RULES());
        }
    }

    /// @notice Nothing that the rules forbid ever succeeded, and tasks were served in order of registration.
    function invariant_nothingForbiddenHappened() public view {
        assertEq(_handler.violation(), "");
    }

    /// @dev At the end of every run: whatever state it ended in, everything gets out without oracle and
    /// administrator.
    function afterInvariant() public {
        for (bool running = true; running;) {
            running = false;
            vm.warp(block.timestamp + 2 hours);
            for (TaskId taskId = taskNo(1); exists(taskId); taskId = following(taskId)) {
                if (!_isRunning(taskId) && state(taskId) != TaskState.Undecided) continue;
                running = true;
                if (tasks.task(taskId).deadline >= block.timestamp) continue;
                vm.prank(stranger);
                tasks.expireTask(taskId);
            }
        }
        for (TaskId taskId = taskNo(1); exists(taskId); taskId = following(taskId)) {
            if (state(taskId) != TaskState.Open) continue;
            Task memory t = tasks.task(taskId);
            vm.prank(t.creator);
            tasks.cancelTask(taskId);
        }
        for (ServiceId serviceId = serviceNo(1); exists(serviceId); serviceId = following(serviceId)) {
            if (services.service(serviceId).state != ServiceState.Retired) {
                update(serviceId, 0, ServiceState.Retired);
            }
        }
        assertEq(coin.balanceOf(address(tasks)), 0, "everything got out");
        uint256 owned = 0;
        for (uint256 i = 0; i < _participants.length; ++i) {
            owned += coin.balanceOf(_participants[i]);
        }
        assertEq(owned, coin.totalSupply(), "and is with the participants");
    }

    function _isRunning(TaskId taskId) private view returns (bool) {
        TaskState current = state(taskId);
        return current == TaskState.Assigned || current == TaskState.Submitted;
    }

    function _isLive(TaskId taskId) private view returns (bool) {
        TaskState current = state(taskId);
        return current == TaskState.Open || current == TaskState.Undecided || _isRunning(taskId);
    }
}
