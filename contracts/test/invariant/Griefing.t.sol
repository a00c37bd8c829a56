// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Test} from "forge-std/Test.sol";
import {ServiceManager} from "../../src/ServiceManager.sol";
import {TaskManager} from "../../src/TaskManager.sol";
import {Service, ServiceState} from "../../src/interfaces/IServiceManager.sol";
import {Fault, Ruling, Task, TaskRequest, TaskState} from "../../src/interfaces/ITaskManager.sol";
import {Units} from "../../src/libraries/Units.sol";
import {Passed} from "../../src/types/Passed.sol";
import {ServiceId} from "../../src/types/ServiceId.sol";
import {NO_TASK, TaskId} from "../../src/types/TaskId.sol";
import {Fixture, Numbers} from "../Fixture.sol";

/// @notice Proven robots and newcomers take tasks, give them back, miss them, prove them and come back, in any order.
contract GriefingHandler is Numbers, Test {
    TaskManager private immutable _tasks;
    ServiceManager private immutable _services;
    address private immutable _judge;
    address[2] private _creators;
    /// @notice What may not happen; empty if nothing did.
    string public violation;
    /// @notice That every way is gone.
    uint256 public passes;
    uint256 public proved;

    constructor(TaskManager tasks, ServiceManager services, address judge, address[2] memory creators) {
        (_tasks, _services, _judge, _creators) = (tasks, services, judge, creators);
    }

    function post(uint256 who, uint256 reward) external {
        reward = bound(reward, 1, 40) * 1 ether;
        vm.prank(_creators[who % 2]);
        _tasks.registerTask(
            TaskRequest("waste_disposal", reward, 1 hours, 1 hours, 3, 0, 0, address(0), "{}")
        );
    }

    function giveBack(uint256 which) external {
        (TaskId taskId, Task memory t) = _at(which, TaskState.Assigned);
        if (t.state != TaskState.Assigned || block.timestamp > t.deadline) return;
        address provider = _services.providerOf(t.serviceId);
        bool proven = _services.providers().isProven(provider);
        bool early = block.timestamp <= t.deadline - 45 minutes;
        ServiceState before = _services.service(t.serviceId).state;
        vm.prank(provider);
        _tasks.abandonTask(taskId, t.attempt);
        if (!early) return;
        ++passes;
        _expectPassed(taskId, t);
        if (proven && _services.service(t.serviceId).state != before) {
            violation = "a give-back cost";
        }
        if (!proven && _services.providers().asleepUntil(provider) == 0) {
            violation = "a newcomer does not rest";
        }
    }

    function _expectPassed(TaskId taskId, Task memory t) private {
        (uint32 number,,) = _services.profile(t.serviceId);
        Passed passed = _tasks.queues().passed(taskId);
        if (!passed.has(number)) violation = "a task forgot whom it passed";
        Task memory after_ = _tasks.task(taskId);
        if (after_.state == TaskState.Failed && !passed.isFull()) {
            violation = "giving back used up an attempt";
        }
        if (after_.state != TaskState.Assigned) return;
        (uint32 next,,) = _services.profile(after_.serviceId);
        if (passed.has(next)) violation = "a task came back to whom it passed";
    }

    function expire(uint256 which) external {
        (TaskId taskId, Task memory t) = _at(which, TaskState.Assigned);
        if (t.state != TaskState.Assigned || block.timestamp <= t.deadline) return;
        _tasks.expireTask(taskId);
    }

    function prove(uint256 which) external {
        (TaskId taskId, Task memory t) = _at(which, TaskState.Assigned);
        if (t.state != TaskState.Assigned || block.timestamp > t.deadline) return;
        vm.prank(_services.providerOf(t.serviceId));
        _tasks.submitProof(taskId, t.attempt, "proof", "");
    }

    /// @dev Half of what is judged is accepted.
    function rule(uint256 which, uint8 said, uint256 until) external {
        (TaskId taskId, Task memory t) = _at(which, TaskState.Submitted);
        if (t.state != TaskState.Submitted && t.state != TaskState.Ruled) return;
        uint256 caseEnd = _tasks.task(taskId).caseEnd;
        if (block.timestamp >= caseEnd) return;
        Ruling ruling = said % 2 == 0 ? Ruling.Accepted : Ruling(bound(said, 2, 5));
        until = until % 2 == 0 ? 0 : bound(until, block.timestamp + 1, caseEnd);
        bool before = _services.providers().isProven(_services.providerOf(t.serviceId));
        vm.prank(_judge);
        _tasks.rule(
            taskId,
            t.attempt,
            t.proofHash,
            ruling,
            Fault.Nobody,
            ruling == Ruling.Accepted ? t.price : 0,
            uint40(until),
            0
        );
        if (!before && _services.providers().isProven(_services.providerOf(t.serviceId))) ++proved;
    }

    function conclude(uint256 which) external {
        (TaskId taskId,) = _at(which, TaskState.Ruled);
        try _tasks.conclude(taskId) {} catch {}
    }

    /// @dev Anybody, with any service. What is taken was free and had not passed it.
    function meet(uint256 which, uint256 service) external {
        (TaskId taskId, Task memory t) = _at(which, TaskState.Open);
        if (t.state != TaskState.Open) return;
        ServiceId serviceId = serviceNo(bound(service, 1, _services.serviceCount()));
        Service memory s = _services.service(serviceId);
        (uint32 number,, bool offered) = _services.profile(serviceId);
        Passed passed = _tasks.queues().passed(taskId);
        bool may = !passed.has(number) && (offered || !passed.isForProven());
        try _tasks.matchTask(taskId, serviceId) {
            if (!may || s.state != ServiceState.Active) violation = "a task met whom it may not";
        } catch {
            if (may && s.place != 0 && s.price <= t.reward) violation = "they did not meet";
        }
    }

    function update(uint256 which, uint8 next, uint256 price) external {
        ServiceId serviceId = serviceNo(bound(which, 1, _services.serviceCount()));
        Service memory s = _services.service(serviceId);
        ServiceState state = next % 3 == 0 ? ServiceState.Paused : ServiceState.Active;
        vm.prank(s.provider);
        try _services.updateService(serviceId, bound(price, 1, 20) * 1 ether, state) {} catch {}
    }

    function wakeUp(uint256 which) external {
        ServiceId serviceId = serviceNo(bound(which, 1, _services.serviceCount()));
        vm.prank(_services.providerOf(serviceId));
        try _services.wakeUp() {} catch {}
    }

    function pass(uint256 time) external {
        vm.warp(block.timestamp + bound(time, 1, 40 minutes));
    }

    /// @dev A task in this state, if there is one among the next ones.
    function _at(uint256 which, TaskState wanted) private view returns (TaskId taskId, Task memory t) {
        uint256 count = _tasks.taskCount();
        which = bound(which, 1, count);
        for (uint256 i = 0; i < count; ++i) {
            taskId = taskNo((which + i - 1) % count + 1);
            t = _tasks.task(taskId);
            if (t.state == wanted) break;
        }
    }
}

/// @notice Proven robots, one service each, and newcomers, two each.
contract GriefingInvariants is Fixture {
    GriefingHandler private _handler;
    uint256 private constant ROBOTS = 3;

    function setUp() public override {
        super.setUp();
        setTerms(20 ether, 5 ether, 0);
        address[3] memory robots = [robot1, robot2, robot3];
        for (uint256 i = 0; i < 7; ++i) {
            address provider = i < ROBOTS ? robots[i] : address(uint160(0x6000 + i));
            vm.prank(bob);
            coin.transfer(provider, 60 ether);
            vm.prank(provider);
            coin.approve(address(tasks), type(uint256).max);
            offer(provider, 5 ether);
            if (i >= ROBOTS) offer(provider, 6 ether);
        }
        _handler = new GriefingHandler(tasks, services, address(oracleJudge), [alice, bob]);
        _handler.post(0, 1);
        targetContract(address(_handler));
    }

    /// @notice What holds after each call. One campaign asks for all of it: others would make the same calls again.
    function invariant_everythingHolds() public view {
        _nothingForbiddenHappens();
        _linesAgreeWithWhatIsAvailable();
        _tasksMeetWhoMayDoThem();
        _escrowHoldsRewardsAndBonds();
    }

    function _nothingForbiddenHappens() private view {
        assertEq(_handler.violation(), "");
    }

    /// @dev What waits is active, does nothing and does not rest, and one service of a newcomer waits or works.
    function _linesAgreeWithWhatIsAvailable() private view {
        uint256 active = 0;
        for (uint256 i = 1; i <= services.serviceCount(); ++i) {
            Service memory s = services.service(serviceNo(i));
            if (s.proven && s.state == ServiceState.Active) ++active;
            assertEq(
                s.proven, providers.isProven(s.provider), "a service knows whether its provider is proven"
            );
            if (s.place != 0) {
                assertTrue(s.state == ServiceState.Active && s.taskId == NO_TASK, "it is available");
                if (!s.proven) assertEq(providers.asleepUntil(s.provider), 0, "it does not rest");
            } else if (i <= ROBOTS) {
                assertFalse(s.state == ServiceState.Active && s.taskId == NO_TASK, "a proven one waits");
            }
            if (s.proven || s.place == 0) continue;
            for (uint256 j = i + 1; j <= services.serviceCount(); ++j) {
                Service memory other = services.service(serviceNo(j));
                if (other.provider == s.provider) assertEq(other.place, 0, "one at a time");
            }
        }
        for (uint256 i = 1; i <= services.serviceCount(); ++i) {
            (, bool proven, bool offered) = services.profile(serviceNo(i));
            assertEq(offered, proven || active == 0, "active services of proven providers are counted");
        }
    }

    /// @dev No open task waits beside a service that may do it: with so few services and tasks, matches overlook nothing.
    function _tasksMeetWhoMayDoThem() private view {
        for (uint256 i = 1; i <= services.serviceCount(); ++i) {
            Service memory s = services.service(serviceNo(i));
            if (s.place == 0) continue;
            (uint32 number,,) = services.profile(serviceNo(i));
            for (TaskId id = taskNo(1); exists(id); id = following(id)) {
                Task memory t = tasks.task(id);
                Passed passed = tasks.queues().passed(id);
                // A newcomer that became proven waits where it waited before.
                bool offered = i <= ROBOTS || !passed.isForProven();
                if (t.state != TaskState.Open || passed.has(number) || !offered) continue;
                bool fits = Units.levelFor(s.price, 1 gwei) <= Units.levelOf(t.reward, 1 gwei);
                if (_isAmongFirst(id, number)) assertFalse(fits, "a task and its service wait");
            }
        }
    }

    function _escrowHoldsRewardsAndBonds() private view {
        uint256 owed = 0;
        for (TaskId id = taskNo(1); exists(id); id = following(id)) {
            Task memory t = tasks.task(id);
            if (t.state == TaskState.Ruled) owed += tasks.standing(id).penalty;
            if (t.state < TaskState.Settled) owed += t.reward;
        }
        for (uint256 i = 1; i <= services.serviceCount(); ++i) {
            owed += services.service(serviceNo(i)).bond;
        }
        assertEq(tasks.held(), owed);
        assertEq(coin.balanceOf(address(tasks)), owed);
    }

    /// @dev Every task ends without judges and administrator, and every bond comes back.
    function afterInvariant() public {
        for (uint256 round = 0; round < 12; ++round) {
            skip(5 hours);
            for (TaskId id = taskNo(1); exists(id); id = following(id)) {
                TaskState current = state(id);
                vm.prank(current == TaskState.Open ? tasks.task(id).creator : stranger);
                if (current == TaskState.Open) {
                    tasks.cancelTask(id);
                }
                // One that another's end has just freed a service for waits for the next round.
                else if (current == TaskState.Assigned && block.timestamp > tasks.task(id).deadline) {
                    tasks.expireTask(id);
                } else if (current == TaskState.Submitted || current == TaskState.Ruled) {
                    tasks.conclude(id);
                }
            }
        }
        skip(3 days);
        for (uint256 i = 1; i <= services.serviceCount(); ++i) {
            if (services.service(serviceNo(i)).state != ServiceState.Retired) {
                update(serviceNo(i), 1 ether, ServiceState.Retired);
            }
        }
        for (TaskId id = taskNo(1); exists(id); id = following(id)) {
            assertGe(uint8(state(id)), uint8(TaskState.Settled), "a task has no exit");
        }
        assertEq(coin.balanceOf(address(tasks)), 0, "everything got out");
    }

    /// @dev Fewer than four older tasks have passed this provider: also those that somebody does by now, because they may have
    /// been open when the match looked.
    function _isAmongFirst(TaskId id, uint32 number) private view returns (bool) {
        uint256 before = 0;
        for (TaskId older = taskNo(1); older < id; older = following(older)) {
            if (tasks.queues().passed(older).has(number)) ++before;
        }
        return before < 4;
    }
}
