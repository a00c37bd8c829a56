// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {MAX_RULES} from "../../src/interfaces/IOrganization.sol";
import {IMatchingPolicy} from "../../src/interfaces/IMatchingPolicy.sol";
import {Service, ServiceState} from "../../src/interfaces/IServiceManager.sol";
import {Hire, Standing, Task, TaskState} from "../../src/interfaces/ITaskManager.sol";
import {HighestReputation} from "../../src/policies/HighestReputation.sol";
import {LowestPrice} from "../../src/policies/LowestPrice.sol";
import {NO_SERVICE, ServiceId} from "../../src/types/ServiceId.sol";
import {NO_TASK, TaskId} from "../../src/types/TaskId.sol";
import {AUDITOR_ROLE, ORACLE_ROLE} from "../../src/types/Roles.sol";
import {Fixture} from "../Fixture.sol";
import {UnrulyPolicy} from "../StubPolicies.sol";
import {Handler} from "./Handler.sol";

contract EscrowInvariants is Fixture {
    Handler private _handler;
    address[] private _participants;

    function setUp() public override {
        super.setUp();
        vm.prank(admin);
        organization.setWindows(CLEANING, windows(SHORTEST, uint16(GRACE)), 40 ether);
        address[] memory creators = new address[](3);
        (creators[0], creators[1], creators[2]) = (alice, bob, robot1);
        address[] memory robots = new address[](3);
        (robots[0], robots[1], robots[2]) = (robot1, robot2, robot3);
        for (uint256 i = 1; i < 3; ++i) {
            vm.prank(bob);
            coin.transfer(robots[i], 500 ether);
            vm.prank(robots[i]);
            coin.approve(address(tasks), type(uint256).max);
        }
        IMatchingPolicy[] memory policies = new IMatchingPolicy[](4);
        (policies[0], policies[1]) = (policy, LowestPrice(deployed("LowestPrice")));
        (policies[2], policies[3]) = (HighestReputation(deployed("HighestReputation")), new UnrulyPolicy());
        _participants = [alice, bob, robot1, robot2, robot3, address(organization)];
        _handler = new Handler(coin, organization, admin, oracle, auditor, creators, robots, policies);
        // Whoever may not judge has the roles all the same: what stops it is that it is a party.
        address[5] memory others = [alice, bob, robot1, robot2, robot3];
        (bytes32 role, bytes32 oracles) = (AUDITOR_ROLE, ORACLE_ROLE);
        for (uint256 i = 0; i < others.length; ++i) {
            vm.prank(admin);
            organization.grantRole(role, others[i]);
            vm.prank(admin);
            organization.grantRole(oracles, others[i]);
        }
        targetContract(address(_handler));
    }

    /// @notice What holds after each call, whatever was called before. One campaign asks for all of it: most of the time of
    /// a campaign is the calls.
    function invariant_everythingHolds() public view {
        Task[] memory posted = new Task[](tasks.taskCount());
        for (uint256 i = 0; i < posted.length; ++i) {
            posted[i] = tasks.task(taskNo(i + 1));
        }
        Service[] memory offered = new Service[](services.serviceCount());
        for (uint256 i = 0; i < offered.length; ++i) {
            offered[i] = services.service(serviceNo(i + 1));
        }
        assertEq(_handler.violation(), "", "something forbidden succeeded, or tasks were served out of order");
        _escrowEqualsLiveRewardsAndBonds(posted, offered);
        _nobodyGainsOrLosesOtherwise();
        _runningTasksAndBusyServicesArePairs(posted, offered);
        _nothingWaitsThatCouldRun(offered);
        _nobodyWaitsForWhoIsFree(posted, offered);
        _theOldestOpenTaskIsNext(posted);
        _everyServiceStandsWhereItsTermsPutIt(offered);
        _whoIsNotThereSleeps(offered);
        _reputationIsWorkForOthersByValue(offered);
        _theCurrentRulesAreThoseThatWereNamed();
    }

    /// @dev The escrow holds the rewards of live tasks, the bonds, and what is set aside of bonds, no more and no less:
    /// terminal tasks and services that have gone hold nothing.
    function _escrowEqualsLiveRewardsAndBonds(Task[] memory posted, Service[] memory offered) private view {
        uint256 held = 0;
        for (uint256 i = 0; i < posted.length; ++i) {
            if (_isLive(posted[i].state)) held += posted[i].reward;
            Standing memory s = tasks.standing(taskNo(i + 1));
            assertEq(s.until != 0, posted[i].state == TaskState.Ruled, "a ruling stands where none may");
            held += s.penalty;
        }
        for (uint256 i = 0; i < offered.length; ++i) {
            held += offered[i].bond;
        }
        assertEq(coin.balanceOf(address(tasks)), held, "the escrow is not the live rewards and bonds");
        assertEq(tasks.held(), held, "the escrow is not counted rightly");
    }

    /// @dev Everyone owns what its own calls and the rules say.
    function _nobodyGainsOrLosesOtherwise() private view {
        for (uint256 i = 0; i < _participants.length; ++i) {
            assertEq(
                coin.balanceOf(_participants[i]),
                _handler.expected(_participants[i]),
                "somebody gained or lost"
            );
        }
    }

    /// @dev A running task has a service that does just this task, and a busy service a task that runs.
    function _runningTasksAndBusyServicesArePairs(Task[] memory posted, Service[] memory offered)
        private
        pure
    {
        for (uint256 i = 0; i < posted.length; ++i) {
            if (!_isRunning(posted[i].state)) continue;
            Service memory s = offered[ServiceId.unwrap(posted[i].serviceId) - 1];
            assertEq(s.taskId, taskNo(i + 1), "the service of a task does another");
        }
        for (uint256 i = 0; i < offered.length; ++i) {
            if (offered[i].taskId == NO_TASK) continue;
            Task memory t = posted[TaskId.unwrap(offered[i].taskId) - 1];
            assertTrue(_isRunning(t.state), "a service is busy with a task that has ended");
            assertEq(t.serviceId, serviceNo(i + 1), "the task of a service is another's");
        }
    }

    /// @dev Nobody waits for what is there: no open task can be done by a service that waits.
    function _nothingWaitsThatCouldRun(Service[] memory offered) private view {
        for (uint256 i = 0; i < offered.length; ++i) {
            bool available = offered[i].state == ServiceState.Active && offered[i].taskId == NO_TASK;
            assertEq(offered[i].place != 0, available, "a service waits exactly when it is available");
            if (available) {
                TaskId fitting = tasks.queues().oldestOpen(serviceNo(i + 1), cleaning(), offered[i].price);
                bool overlooked = _handler.mayOverlook(fitting, offered[i].provider);
                assertTrue(fitting == NO_TASK || overlooked, "a task and its service wait");
            }
        }
    }

    /// @dev No task waits for a service that it names, or for a service of the provider that it names, which is free.
    function _nobodyWaitsForWhoIsFree(Task[] memory posted, Service[] memory offered) private pure {
        for (uint256 i = 0; i < posted.length; ++i) {
            Task memory t = posted[i];
            if (t.state != TaskState.Open || t.hired == Hire.None) continue;
            for (uint256 j = 0; j < offered.length; ++j) {
                bool named = t.serviceId == serviceNo(j + 1) || t.provider == offered[j].provider;
                bool free = offered[j].place != 0 && offered[j].price <= t.reward;
                assertFalse(named && free, "a task waits for a service that is free");
            }
        }
    }

    /// @dev What waits can be found, and the oldest comes first.
    function _theOldestOpenTaskIsNext(Task[] memory posted) private view {
        TaskId oldest = NO_TASK;
        for (uint256 i = 0; i < posted.length && oldest == NO_TASK; ++i) {
            if (posted[i].state == TaskState.Open && posted[i].hired == Hire.None) oldest = taskNo(i + 1);
        }
        assertEq(
            tasks.queues().oldestOpen(NO_SERVICE, cleaning(), 0),
            oldest,
            "the oldest open task is not the next one"
        );
    }

    /// @dev Bonds, failures and suspensions are what the terms make of what happened.
    function _everyServiceStandsWhereItsTermsPutIt(Service[] memory offered) private view {
        for (uint256 i = 0; i < offered.length; ++i) {
            Service memory s = offered[i];
            (uint256 bond,,, bool suspended,) = _handler.ghost(serviceNo(i + 1));
            assertEq(s.bond, bond, "the bond is not what the terms left of it");
            assertEq(
                s.state == ServiceState.Suspended, suspended, "suspended against the terms, or not suspended"
            );
            assertEq(s.failures, _handler.failures(s.provider), "failures are not counted rightly");
        }
    }

    /// @dev Who is asleep let attempts pass since it last worked for others. Giving back is no miss.
    function _whoIsNotThereSleeps(Service[] memory offered) private view {
        for (uint256 i = 0; i < offered.length; ++i) {
            address provider = offered[i].provider;
            assertEq(
                providers.asleepUntil(provider),
                _handler.asleepUntil(provider),
                "asleep without a cause, or awake"
            );
        }
    }

    /// @dev A provider is known for what it did for others, by value, whichever of its services did it; less so with time.
    function _reputationIsWorkForOthersByValue(Service[] memory offered) private view {
        for (uint256 i = 0; i < offered.length; ++i) {
            Service memory s = offered[i];
            assertApproxEqAbs(
                s.reputation, _handler.reputation(s.provider), 1, "reputation is not work for others"
            );
        }
    }

    /// @dev Tasks are posted under the rules that the administrator has named and not retired, and under no others; nobody
    /// looks through many.
    function _theCurrentRulesAreThoseThatWereNamed() private view {
        bytes32[2] memory kinds = [CLEANING, CHARGING];
        for (uint256 i = 0; i < kinds.length; ++i) {
            bytes32[] memory current = organization.currentRules(kinds[i]);
            assertEq(
                current, _handler.expectedRules(kinds[i]), "the current rules are not those that were named"
            );
            assertLe(current.length, MAX_RULES, "too many rules");
        }
    }

    /// @dev At the end of every run: whatever state it ended in, everything gets out without oracle and
    /// administrator.
    function afterInvariant() public {
        for (bool running = true; running;) {
            running = false;
            vm.warp(block.timestamp + 2 hours);
            for (TaskId taskId = taskNo(1); exists(taskId); taskId = following(taskId)) {
                bool ruled = state(taskId) == TaskState.Ruled;
                if (!ruled && !_isRunning(state(taskId))) continue;
                running = true;
                uint256 end = ruled ? tasks.standing(taskId).until : tasks.task(taskId).deadline;
                if (end >= block.timestamp) continue;
                vm.prank(stranger);
                if (state(taskId) == TaskState.Assigned) tasks.expireTask(taskId);
                else tasks.conclude(taskId);
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

    function _isRunning(TaskState current) private pure returns (bool) {
        return current == TaskState.Assigned || current == TaskState.Submitted;
    }

    function _isLive(TaskState current) private pure returns (bool) {
        return current == TaskState.Open || current == TaskState.Ruled || _isRunning(current);
    }
}
