// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Test} from "forge-std/Test.sol";
import {Organization} from "../../src/Organization.sol";
import {ServiceManager} from "../../src/ServiceManager.sol";
import {TaskManager} from "../../src/TaskManager.sol";
import {Service, ServiceState} from "../../src/interfaces/IServiceManager.sol";
import {Fault, Ruling, Standing, Task, TaskRequest, TaskState} from "../../src/interfaces/ITaskManager.sol";
import {KindId} from "../../src/types/KindId.sol";
import {ServiceId} from "../../src/types/ServiceId.sol";
import {TaskId} from "../../src/types/TaskId.sol";
import {Fixture, Numbers} from "../Fixture.sol";

/// @notice Posts, proves, rules, replaces and concludes, in any order and at any time.
contract RulingsHandler is Numbers, Test {
    TaskManager private immutable _tasks;
    ServiceManager private immutable _services;
    Organization private immutable _organization;
    /// @dev The kind's judge, and whoever rules when that one was removed.
    address[2] private _judges;
    bool private _removed;
    address private immutable _creator;
    /// @notice What succeeded that may not, or failed that may not; empty if nothing.
    string public violation;
    uint256 public concluded;
    uint256 public replaced;

    constructor(TaskManager tasks, ServiceManager services, address[2] memory judges, address creator) {
        (_tasks, _services, _judges, _creator) = (tasks, services, judges, creator);
        _organization = Organization(address(tasks.organization()));
    }

    function post(uint256 reward) external {
        if (_removed) return; // nobody posts tasks of the kind any more
        reward = bound(reward, 10, 50) * 1 ether;
        vm.prank(_creator);
        _tasks.registerTask(
            TaskRequest("waste_disposal", reward, 1 hours, 1 hours, 3, 0, 0, address(0), "{}")
        );
    }

    function prove(uint256 which) external {
        (TaskId taskId, Task memory t) = _at(which);
        if (t.state != TaskState.Assigned || block.timestamp > t.deadline) return;
        vm.prank(_services.providerOf(t.serviceId));
        _tasks.submitProof(taskId, t.attempt, keccak256(abi.encode(which)), "");
    }

    function rule(uint256 which, uint8 said, uint256 amount, uint256 until) external {
        (TaskId taskId, Task memory t) = _at(which);
        if (t.state != TaskState.Submitted && t.state != TaskState.Ruled) return;
        uint256 caseEnd = _tasks.task(taskId).caseEnd;
        if (block.timestamp > caseEnd) return;
        Ruling ruling = Ruling(bound(said, 1, 5));
        amount = ruling == Ruling.Accepted ? bound(amount, 1, t.price) : 0;
        until = until % 3 == 0 || block.timestamp == caseEnd ? 0 : bound(until, block.timestamp + 1, caseEnd);
        if (t.state == TaskState.Ruled) ++replaced;
        vm.prank(_judges[_removed ? 0 : 1]);
        try _tasks.rule(
            taskId, t.attempt, t.proofHash, ruling, Fault.Nobody, uint96(amount), uint40(until), 0
        ) {
            violation =
                "who is no judge ruled";
        } catch {}
        vm.prank(_judges[_removed ? 1 : 0]);
        _tasks.rule(taskId, t.attempt, t.proofHash, ruling, Fault.Nobody, uint96(amount), uint40(until), 0);
        bool stands = _tasks.task(taskId).state == TaskState.Ruled;
        if (stands != (until != 0)) violation = "a ruling stands that is final, or the other way round";
    }

    /// @dev A stranger, at any time.
    function conclude(uint256 which) external {
        (TaskId taskId, Task memory t) = _at(which);
        bool submitted = t.state == TaskState.Submitted && block.timestamp > t.deadline;
        Standing memory s = _tasks.standing(taskId);
        bool ruled = t.state == TaskState.Ruled && block.timestamp > s.until;
        // What a judge said that was removed ends at once; what the auditors said does not.
        if (t.state == TaskState.Ruled && _removed && !s.afterRemoval) ruled = true;
        vm.prank(address(0xbad));
        try _tasks.conclude(taskId) {
            if (!submitted && !ruled) violation = "concluded before its time";
            ++concluded;
        } catch {
            if (submitted || ruled) violation = "a case has no end";
        }
    }

    /// @dev A guardian takes the judge's right away, once, late in most runs.
    function removeJudge(uint256 chance) external {
        if (chance % 16 != 0 || _removed) return;
        vm.prank(_organization.defaultAdmin());
        _organization.removeJudge(KindId.wrap(1));
        _removed = true;
    }

    function expire(uint256 which) external {
        (TaskId taskId, Task memory t) = _at(which);
        if (t.state == TaskState.Assigned && block.timestamp > t.deadline) _tasks.expireTask(taskId);
    }

    function update(uint256 which, uint8 next) external {
        ServiceId serviceId = serviceNo(bound(which, 1, _services.serviceCount()));
        Service memory s = _services.service(serviceId);
        bool retires = next % 8 == 0;
        if (s.state == ServiceState.Retired) return;
        if (!retires && (s.state == ServiceState.Suspended || s.bond < s.penalty)) return;
        if (!retires && _services.providers().asleepUntil(s.provider) != 0) return;
        vm.prank(s.provider);
        _services.updateService(serviceId, s.price, retires ? ServiceState.Retired : ServiceState.Active);
    }

    function pass(uint256 time) external {
        vm.warp(block.timestamp + bound(time, 1, 1 hours));
    }

    function _at(uint256 which) private view returns (TaskId taskId, Task memory t) {
        taskId = taskNo(bound(which, 1, _tasks.taskCount()));
        t = _tasks.task(taskId);
    }
}

/// @notice Whatever stands, is replaced and is concluded: nobody's money is gone or there twice.
contract RulingsInvariants is Fixture {
    RulingsHandler private _handler;

    function setUp() public override {
        super.setUp();
        setTerms(20 ether, 5 ether, 0);
        address[3] memory robots = [robot1, robot2, robot3];
        for (uint256 i = 0; i < 3; ++i) {
            vm.prank(bob);
            coin.transfer(robots[i], 300 ether);
            vm.prank(robots[i]);
            coin.approve(address(tasks), type(uint256).max);
            offer(robots[i], 5 ether);
        }
        _handler = new RulingsHandler(tasks, services, [address(oracleJudge), address(auditorJudge)], alice);
        _handler.post(0);
        targetContract(address(_handler));
    }

    /// @notice What holds after each call. One campaign asks for all of it: others would make the same calls again.
    function invariant_everythingHolds() public view {
        _nothingForbiddenHappens();
        _escrowHoldsRewardsBondsAndWhatIsSetAside();
        _aServiceDoesWhatItsTaskSays();
    }

    function _nothingForbiddenHappens() private view {
        assertEq(_handler.violation(), "");
    }

    function _escrowHoldsRewardsBondsAndWhatIsSetAside() private view {
        uint256 owed;
        for (TaskId id = taskNo(1); exists(id); id = following(id)) {
            Task memory t = tasks.task(id);
            bool ended =
                t.state == TaskState.Settled || t.state == TaskState.Failed || t.state == TaskState.Cancelled;
            if (!ended) owed += t.reward;
            Standing memory s = tasks.standing(id);
            owed += s.penalty;
            assertEq(s.until != 0, t.state == TaskState.Ruled);
        }
        for (ServiceId id = serviceNo(1); exists(id); id = following(id)) {
            owed += services.service(id).bond;
        }
        assertEq(tasks.held(), owed);
        assertEq(coin.balanceOf(address(tasks)), owed);
    }

    /// @notice Whatever state a run ended in, strangers bring every case to its end.
    function afterInvariant() public {
        for (uint256 i = 0; i < 3; ++i) {
            vm.warp(block.timestamp + 1 hours + AUDIT_WINDOW + 1);
            for (TaskId id = taskNo(1); exists(id); id = following(id)) {
                vm.startPrank(stranger);
                bool late = tasks.task(id).deadline < block.timestamp;
                if (state(id) == TaskState.Assigned && late) tasks.expireTask(id);
                if (state(id) == TaskState.Submitted || state(id) == TaskState.Ruled) tasks.conclude(id);
                vm.stopPrank();
                bool ended = state(id) != TaskState.Submitted && state(id) != TaskState.Ruled;
                assertTrue(ended, "a case has no end");
            }
        }
        _escrowHoldsRewardsBondsAndWhatIsSetAside();
    }

    function _aServiceDoesWhatItsTaskSays() private view {
        for (TaskId id = taskNo(1); exists(id); id = following(id)) {
            Task memory t = tasks.task(id);
            if (t.state != TaskState.Assigned && t.state != TaskState.Submitted) continue;
            assertEq(services.service(t.serviceId).taskId, id);
        }
    }
}
