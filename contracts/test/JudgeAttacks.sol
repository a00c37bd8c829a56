// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Finding, IJudge} from "../src/interfaces/IJudge.sol";
import {Fault, ITaskManager, Ruling, TaskState} from "../src/interfaces/ITaskManager.sol";
import {ServiceState} from "../src/interfaces/IServiceManager.sol";
import {KindId} from "../src/types/KindId.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Instances} from "./Instances.sol";
import {Possession} from "./Possession.sol";

/// @notice Twenty attacks on whoever judges, which each judge withstands: as executor, seller, creator, judge, administrator and
/// stranger.
abstract contract JudgeAttacks is Instances {
    uint96 private constant BOND = 20 ether;
    uint96 private constant PENALTY = 5 ether;
    TaskId private _task;
    ServiceId private _service;

    /// @dev Whose turn it is to be attacked.
    function target() internal view virtual returns (IJudge);

    /// @dev What those say who judge, whoever sends it.
    function say(address sender, Finding memory f) internal virtual;

    /// @dev Somebody who is a party judges, too, and is among those who say so.
    function sayAs(address party, uint256 secret, Finding memory f) internal virtual;

    /// @dev The case is over and what was said is done.
    function finish(TaskId taskId) internal {
        if (state(taskId) != TaskState.Ruled) return;
        vm.warp(tasks.standing(taskId).until + 1);
        tasks.conclude(taskId);
    }

    function setUp() public virtual override {
        super.setUp();
        IJudge judge_ = target();
        vm.prank(admin);
        organization.allowKind(CLEANING, judge_, RULES);
        setTerms(BOND, PENALTY, 0);
        // Parties have seats in the committee, too, which do not help them.
        seat(alice, alice);
        seat(robot1, robot1);
        seat(robot2, robot2);
        setQuorum(VOTES, JUDGES, 1, 0xff);
        _task = waiting();
        skip(JUDGES);
        _service = tasks.task(_task).serviceId;
    }

    // -- strangers -----------------------------------------------------------------------------------------

    function test_attack_01_aStrangerRules() public {
        _refusedByTasks(stranger);
    }

    function test_attack_02_aStrangerConcludesEarly() public {
        vm.expectPartialRevert(ITaskManager.DeadlineNotPassed.selector);
        vm.prank(stranger);
        tasks.conclude(_task);
    }

    function test_attack_03_aStrangerReplacesWhatTheNextInstanceMay() public {
        Finding memory f = voteOf(_task, Ruling.Accepted);
        vm.expectPartialRevert(IJudge.NotNext.selector);
        vm.prank(stranger);
        target().ruleForNext(f, "");
    }

    // -- executor and seller -------------------------------------------------------------------------------

    function test_attack_04_theExecutorRules() public {
        _refusedByTasks(robot1);
    }

    function test_attack_05_theExecutorJudgesItself() public {
        (address key, uint256 secret) = makeAddrAndKey("robot1");
        vm.expectRevert(abi.encodeWithSelector(IJudge.JudgeIsParty.selector, _task, key));
        this.saysAs(key, secret);
    }

    function test_attack_06_theExecutorsDeviceJudges() public {
        (address key, uint256 secret) = makeAddrAndKey("robot2");
        vm.prank(admin);
        Possession.register(organization, key, "wallet", robot1, "robot2");
        vm.expectRevert(abi.encodeWithSelector(IJudge.JudgeIsParty.selector, _task, key));
        this.saysAs(key, secret);
    }

    function test_attack_07_theForgerWaitsUntilNobodyClosesItsRejection() public {
        say(_sender(), voteOf(_task, Ruling.Rejected));
        uint256 before = coin.balanceOf(robot1);
        vm.warp(block.timestamp + 365 days);
        if (state(_task) == TaskState.Ruled) tasks.conclude(_task);
        assertEq(coin.balanceOf(robot1), before);
        assertEq(services.service(_service).rejected, 1);
    }

    function test_attack_08_theForgerRetiresBeforeTheRuling() public {
        update(_service, 80 ether, ServiceState.Retired);
        uint256 before = coin.balanceOf(robot1);
        say(_sender(), voteOf(_task, Ruling.Rejected));
        finish(_task);
        assertEq(coin.balanceOf(robot1) - before, BOND - PENALTY);
    }

    function test_attack_09_theExecutorIsPaidForSilence() public {
        uint256 before = coin.balanceOf(robot1);
        vm.warp(tasks.task(_task).deadline + 1);
        tasks.conclude(_task);
        finish(_task);
        assertEq(coin.balanceOf(robot1), before);
        assertState(_task, TaskState.Failed);
    }

    function test_attack_10_theExecutorReplacesItsProof() public {
        say(_sender(), voteOf(_task, Ruling.Rejected));
        bool stands = state(_task) == TaskState.Ruled;
        vm.expectPartialRevert(stands ? ITaskManager.WrongState.selector : ITaskManager.WrongAttempt.selector);
        vm.prank(robot1);
        tasks.submitProof(_task, 1, keccak256("other"), URI);
    }

    // -- creator -------------------------------------------------------------------------------------------

    function test_attack_11_theCreatorRules() public {
        _refusedByTasks(alice);
    }

    function test_attack_12_theCreatorJudgesWhatItOwes() public {
        (address key, uint256 secret) = makeAddrAndKey("alice");
        vm.expectRevert(abi.encodeWithSelector(IJudge.JudgeIsParty.selector, _task, key));
        this.saysAs(key, secret);
    }

    function test_attack_13_theCreatorCancelsWhatIsRuled() public {
        say(_sender(), voteOf(_task, Ruling.Accepted));
        vm.expectPartialRevert(ITaskManager.WrongState.selector);
        vm.prank(alice);
        tasks.cancelTask(_task);
    }

    // -- judges --------------------------------------------------------------------------------------------

    function test_attack_14_theyPayMoreThanThePrice() public {
        Finding memory f = voteOf(_task, Ruling.Accepted);
        f.amount = 80 ether + 1;
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.InvalidAmount.selector, _task, f.amount, 80 ether)
        );
        this.says(f);
    }

    function test_attack_15_theyPayForWhatTheyDoNotAccept() public {
        Finding memory f = voteOf(_task, Ruling.Void);
        f.amount = 1;
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.InvalidAmount.selector, _task, 1, 0));
        this.says(f);
    }

    function test_attack_16_theyJudgeAnotherProofOrAttempt() public {
        Finding memory f = voteOf(_task, Ruling.Accepted);
        f.proofHash = keccak256("other");
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.ProofMismatch.selector, _task, PROOF, f.proofHash)
        );
        this.says(f);
        (f.proofHash, f.attempt) = (PROOF, 2);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.WrongAttempt.selector, _task, 1, 2));
        this.says(f);
    }

    function test_attack_17_theySayTheSameTwice() public {
        Finding memory f = voteOf(_task, Ruling.Accepted);
        say(_sender(), f);
        finish(_task);
        vm.expectPartialRevert(ITaskManager.WrongState.selector);
        this.says(f);
    }

    function test_attack_18_theyRuleAfterTheCase() public {
        Finding memory f = voteOf(_task, Ruling.Accepted);
        vm.warp(tasks.task(_task).caseEnd + 1);
        vm.expectRevert();
        this.says(f);
        tasks.conclude(_task);
        assertState(_task, TaskState.Failed);
    }

    // -- administrator -------------------------------------------------------------------------------------

    function test_attack_19_theAdministratorRulesOrNamesAnotherJudgeForARunningTask() public {
        _refusedByTasks(admin);
        IJudge other = IJudge(_isOracle() ? auditorJudge : oracleJudge);
        vm.prank(admin);
        organization.allowKind(CLEANING, other, RULES);
        _refusedByTasks(address(other));
        uint256 before = coin.balanceOf(robot1);
        say(_sender(), voteOf(_task, Ruling.Accepted));
        finish(_task);
        assertEq(coin.balanceOf(robot1) - before, 80 ether);
    }

    function test_attack_20_aRemovedJudgeRules() public {
        Finding memory f = voteOf(_task, Ruling.Accepted);
        KindId number = organization.numberOf(CLEANING);
        vm.startPrank(admin);
        organization.setAuditors(_isOracle() ? auditorJudge : oracleJudge);
        organization.removeJudge(number);
        vm.stopPrank();
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotJudge.selector, address(target()), number));
        this.says(f);
        vm.warp(tasks.task(_task).caseEnd + 1);
        tasks.conclude(_task);
        assertState(_task, TaskState.Failed);
    }

    function says(Finding calldata f) external {
        say(_sender(), f);
    }

    function saysAs(address party, uint256 secret) external {
        sayAs(party, secret, voteOf(_task, Ruling.Accepted));
    }

    function _sender() internal view virtual returns (address) {
        return stranger;
    }

    function _isOracle() private view returns (bool) {
        return address(target()) == address(oracleJudge);
    }

    function _refusedByTasks(address who) private {
        KindId number = tasks.task(_task).kindId;
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotJudge.selector, who, number));
        vm.prank(who);
        tasks.rule(_task, 1, PROOF, Ruling.Accepted, Fault.Nobody, 80 ether, 0, REPORT);
    }
}
