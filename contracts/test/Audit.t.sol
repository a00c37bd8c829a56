// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Review} from "../src/interfaces/IOrganization.sol";
import {Service, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {
    Cause,
    ITaskManager,
    Silence,
    Task,
    TaskRequest,
    TaskState,
    Verdict
} from "../src/interfaces/ITaskManager.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";
import {Possession} from "./Possession.sol";

/// @notice Verdicts with an amount, and what becomes of an attempt that the oracle could not decide.
contract AuditTest is Fixture {
    ServiceId private _serviceId;
    TaskId private _taskId;

    function setUp() public override {
        super.setUp();
        _serviceId = offer(robot1, 80 ether);
        _taskId = post(alice, 100 ether);
        submit(_taskId);
    }

    function _undecide() private {
        judgeAs(oracle, _taskId, Verdict.Undecided, 0);
    }

    function _expire() private {
        vm.warp(block.timestamp + AUDIT_WINDOW + 1);
        vm.prank(stranger);
        tasks.expireTask(_taskId);
    }

    function _setSilence(Silence silence) private {
        vm.prank(admin);
        organization.setAudit(CLEANING, AUDIT_WINDOW, silence);
    }

    function _grant(bytes32 role, address account) private {
        vm.prank(admin);
        organization.grantRole(role, account);
    }

    function _own(address device, address owner) private {
        vm.prank(admin);
        Possession.register(organization, device, "wallet", owner, bytes32(bytes20(device)));
    }

    function _assertIsParty(address who, Verdict verdict, uint256 amount) private {
        bytes memory refusal = abi.encodeWithSelector(ITaskManager.JudgeIsParty.selector, _taskId, who);
        _assertRefused(refusal, who, verdict, amount);
    }

    function _assertRefused(bytes memory refusal, address who, Verdict verdict, uint256 amount) private {
        Task memory t = tasks.task(_taskId);
        vm.expectRevert(refusal);
        vm.prank(who);
        tasks.postVerdict(_taskId, t.attempt, t.proofHash, verdict, amount, REPORT, "", "");
    }

    // -- amounts ------------------------------------------------------------------------------------------

    function test_partOfTheWorkIsPaidInPartAndTheRestReturnsAtOnce() public {
        vm.expectEmit(address(tasks));
        emit ITaskManager.VerdictPosted(
            _taskId, 1, PROOF, Verdict.Accepted, 30 ether, REPORT, "report", "because"
        );
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskSettled(_taskId, robot1, 30 ether, 70 ether);
        judgeAs(oracle, _taskId, Verdict.Accepted, 30 ether);
        assertState(_taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), 2030 ether);
        assertEq(coin.balanceOf(alice), 1970 ether);
        assertEq(coin.balanceOf(address(tasks)), 0);
        assertEq(services.service(_serviceId).completed, 1);
    }

    function test_attack_aJudgePaysMoreThanThePrice() public {
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.InvalidAmount.selector, _taskId, 80 ether + 1, 80 ether),
            oracle,
            Verdict.Accepted,
            80 ether + 1
        );
        _undecide();
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.InvalidAmount.selector, _taskId, 100 ether, 80 ether),
            auditor,
            Verdict.Accepted,
            100 ether
        );
    }

    function test_attack_acceptedWorkIsPaidNothing() public {
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.InvalidAmount.selector, _taskId, 0, 80 ether),
            oracle,
            Verdict.Accepted,
            0
        );
    }

    function test_attack_aVerdictThatDoesNotAcceptPays() public {
        for (uint8 verdict = uint8(Verdict.Rejected); verdict <= uint8(Verdict.Undecided); verdict += 2) {
            _assertRefused(
                abi.encodeWithSelector(ITaskManager.InvalidAmount.selector, _taskId, 1, 0),
                oracle,
                Verdict(verdict),
                1
            );
        }
    }

    function test_aVerdictSaysSomething() public {
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.NoVerdict.selector, _taskId), oracle, Verdict.None, 0
        );
    }

    function testFuzz_everyAmountIsSplitWithoutRest(uint256 amount, bool audited) public {
        amount = bound(amount, 1, 80 ether);
        if (audited) _undecide();
        judgeAs(audited ? auditor : oracle, _taskId, Verdict.Accepted, amount);
        assertEq(coin.balanceOf(robot1), 2000 ether + amount);
        assertEq(coin.balanceOf(alice), 2000 ether - amount);
        assertEq(coin.balanceOf(address(tasks)), 0);
    }

    // -- undecided ----------------------------------------------------------------------------------------

    function test_anUndecidedAttemptWaitsForTheAuditors() public {
        uint256 deadline = block.timestamp + AUDIT_WINDOW;
        vm.expectEmit(address(tasks));
        emit ITaskManager.VerdictPosted(_taskId, 1, PROOF, Verdict.Undecided, 0, REPORT, "report", "because");
        vm.expectEmit(address(tasks));
        emit ITaskManager.AuditRequested(_taskId, 1, deadline, Silence.Executor);
        _undecide();
        Task memory t = tasks.task(_taskId);
        assertEq(uint8(t.state), uint8(TaskState.Undecided));
        assertEq(t.deadline, deadline);
        assertEq(t.proofHash, PROOF);
        assertEq(coin.balanceOf(address(tasks)), 100 ether);
    }

    function test_anUndecidedAttemptCostsTheExecutorNothing() public {
        setTerms(50 ether, 20 ether, 1);
        vm.prank(alice);
        _taskId = tasks.registerTask(request(100 ether));
        ServiceId serviceId = offer(robot1, 80 ether);
        submit(_taskId);
        _undecide();
        Service memory s = services.service(serviceId);
        assertEq(s.bond, 50 ether);
        assertEq(s.failures + s.rejected + s.expired, 0);
        assertEq(uint8(s.state), uint8(ServiceState.Active));
        // It works again at once, and the proof of the next task does not replace the one that waits.
        TaskId next = post(bob, 100 ether);
        assertAssigned(next, serviceId);
        vm.prank(robot1);
        tasks.submitProof(next, 1, "another", URI);
        assertEq(tasks.task(_taskId).proofHash, PROOF);
        judgeAs(auditor, _taskId, Verdict.Accepted, 80 ether);
        assertState(next, TaskState.Submitted);
        assertAfterAudit(serviceId);
    }

    function assertAfterAudit(ServiceId serviceId) private view {
        Service memory s = services.service(serviceId);
        assertEq(s.failures + s.rejected + s.expired, 0);
        assertEq(s.bond, 50 ether);
    }

    function test_anAuditorAccepts() public {
        _undecide();
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskSettled(_taskId, robot1, 50 ether, 50 ether);
        judgeAs(auditor, _taskId, Verdict.Accepted, 50 ether);
        assertState(_taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), 2050 ether);
        assertEq(coin.balanceOf(alice), 1950 ether);
    }

    function test_anAuditorRejectsAndTheTaskQueuesAgain() public {
        _undecide();
        TaskId taskId = _taskId;
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskRequeued(taskId, 1, Cause.Rejected);
        judgeAs(auditor, taskId, Verdict.Rejected, 0);
        assertAssigned(taskId, _serviceId);
        assertEq(tasks.task(taskId).attempt, 2);
        assertEq(tasks.task(taskId).proofHash, 0);
    }

    function test_anAuditorsLastRejectionRefundsTheCreator() public {
        for (uint8 i = 1; i < ATTEMPTS; ++i) {
            judge(_taskId, false);
            submit(_taskId);
        }
        _undecide();
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskFailed(_taskId, 100 ether, ATTEMPTS, Cause.Rejected);
        judgeAs(auditor, _taskId, Verdict.Rejected, 0);
        assertState(_taskId, TaskState.Failed);
        assertEq(coin.balanceOf(alice), 2000 ether);
        assertEq(coin.balanceOf(address(tasks)), 0);
    }

    function test_silentAuditorsLetTheExecutorWinWhereTheKindSaysSo() public {
        _undecide();
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskSettled(_taskId, robot1, 80 ether, 20 ether);
        _expire();
        assertState(_taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), 2080 ether);
        assertEq(coin.balanceOf(alice), 1920 ether);
    }

    function test_silentAuditorsLetTheCreatorWinWhereTheKindSaysSo() public {
        judge(_taskId, true);
        _setSilence(Silence.Creator);
        _taskId = post(bob, 100 ether);
        submit(_taskId);
        _undecide();
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskFailed(_taskId, 100 ether, 1, Cause.AuditExpired);
        _expire();
        assertState(_taskId, TaskState.Failed);
        assertEq(coin.balanceOf(robot1), 2080 ether, "of the first task");
        assertEq(coin.balanceOf(bob), 2000 ether);
        Service memory s = services.service(_serviceId);
        assertEq(s.completed, 1, "the first task");
        assertEq(s.rejected + s.expired + s.failures, 0);
    }

    function test_theAuditorsHaveTheirWholeWindow() public {
        _undecide();
        uint256 deadline = block.timestamp + AUDIT_WINDOW;
        vm.warp(deadline);
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.DeadlineNotPassed.selector, _taskId, deadline, deadline)
        );
        tasks.expireTask(_taskId);
        vm.warp(deadline + 1);
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.DeadlinePassed.selector, _taskId, deadline, deadline + 1),
            auditor,
            Verdict.Accepted,
            80 ether
        );
        vm.warp(deadline);
        judgeAs(auditor, _taskId, Verdict.Accepted, 80 ether);
    }

    // -- adversaries --------------------------------------------------------------------------------------

    function test_attack_theOracleJudgesTwice() public {
        _undecide();
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.NotJudge.selector, oracle, CLEANING),
            oracle,
            Verdict.Rejected,
            0
        );
        _grant(organization.AUDITOR_ROLE(), oracle);
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.JudgedBefore.selector, _taskId, oracle),
            oracle,
            Verdict.Accepted,
            80 ether
        );
    }

    function test_attack_anotherOracleOverrulesTheAuditors() public {
        _undecide();
        _grant(organization.ORACLE_ROLE(), stranger);
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.NotJudge.selector, stranger, CLEANING),
            stranger,
            Verdict.Accepted,
            80 ether
        );
    }

    function test_attack_creatorAndExecutorAreAuditors() public {
        _grant(organization.AUDITOR_ROLE(), alice);
        _grant(organization.AUDITOR_ROLE(), robot1);
        _undecide();
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.JudgeIsParty.selector, _taskId, alice),
            alice,
            Verdict.Rejected,
            0
        );
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.JudgeIsParty.selector, _taskId, robot1),
            robot1,
            Verdict.Accepted,
            80 ether
        );
    }

    function test_attack_ownersJudgeTheirDevices() public {
        _own(robot1, stranger);
        _own(alice, bob);
        for (uint256 i = 0; i < 2; ++i) {
            bytes32 role = i == 0 ? organization.ORACLE_ROLE() : organization.AUDITOR_ROLE();
            _grant(role, stranger);
            _grant(role, bob);
            _grant(role, robot2);
            if (i == 1) _undecide();
            _assertIsParty(stranger, Verdict.Accepted, 80 ether);
            _assertIsParty(bob, Verdict.Rejected, 0);
        }
        // Whom the device registry knows as nobody's.
        judgeAs(robot2, _taskId, Verdict.Accepted, 80 ether);
        assertState(_taskId, TaskState.Settled);
    }

    function test_attack_devicesJudgeTheirOwnersAndTheirOwnersOtherDevices() public {
        address company = makeAddr("company");
        address[3] memory owners = [robot1, alice, company];
        _own(robot1, company);
        for (uint256 i = 0; i < 2; ++i) {
            bytes32 role = i == 0 ? organization.ORACLE_ROLE() : organization.AUDITOR_ROLE();
            _grant(role, robot2);
            _grant(role, robot3);
            if (i == 1) _undecide();
            for (uint256 j = 0; j < owners.length; ++j) {
                uint256 snapshot = vm.snapshotState();
                _own(robot2, owners[j]);
                _assertIsParty(robot2, Verdict.Accepted, 80 ether);
                vm.revertToState(snapshot);
            }
        }
        // A device of somebody else.
        _own(robot3, makeAddr("another company"));
        judgeAs(robot3, _taskId, Verdict.Accepted, 80 ether);
        assertState(_taskId, TaskState.Settled);
    }

    function test_attack_theExecutorLeavesItsOwnWorkUndecidedAndWaits() public {
        _grant(organization.ORACLE_ROLE(), robot1);
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.JudgeIsParty.selector, _taskId, robot1),
            robot1,
            Verdict.Undecided,
            0
        );
    }

    function test_attack_undecidedForEver() public {
        _undecide();
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.AuditorMustDecide.selector, _taskId, auditor),
            auditor,
            Verdict.Undecided,
            0
        );
    }

    function test_attack_anAuditorLeavesUndecidedWhatItAloneJudges() public {
        vm.prank(admin);
        organization.allowKind(CLEANING, Review.Auditor, 0);
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.AuditorMustDecide.selector, _taskId, auditor),
            auditor,
            Verdict.Undecided,
            0
        );
    }

    function test_attack_anAuditorsVerdictOnAnotherProofOrAttempt() public {
        _undecide();
        bytes32 other = keccak256("other");
        vm.startPrank(auditor);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.ProofMismatch.selector, _taskId, PROOF, other));
        tasks.postVerdict(_taskId, 1, other, Verdict.Accepted, 80 ether, REPORT, "", "");
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.WrongAttempt.selector, _taskId, 1, 2));
        tasks.postVerdict(_taskId, 2, PROOF, Verdict.Accepted, 80 ether, REPORT, "", "");
    }

    function test_attack_theRuleOfSilenceChangesWhileTheAuditorsLook() public {
        _undecide();
        _setSilence(Silence.Creator);
        _expire();
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    function test_attack_theAdministratorChangesTheAuditWhileATaskRuns() public {
        vm.prank(admin);
        organization.setAudit(CLEANING, 1 minutes, Silence.Creator);
        uint256 deadline = block.timestamp + AUDIT_WINDOW;
        vm.expectEmit(address(tasks));
        emit ITaskManager.AuditRequested(_taskId, 1, deadline, Silence.Executor);
        _undecide();
        vm.warp(block.timestamp + 61);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.DeadlineNotPassed.selector, _taskId, deadline, block.timestamp
            )
        );
        vm.prank(alice);
        tasks.expireTask(_taskId);
        _expire();
        assertEq(coin.balanceOf(robot1), 2080 ether);
        assertEq(coin.balanceOf(alice), 1920 ether);
    }

    function test_attack_anAuditForATaskThatWasPostedWithoutOne() public {
        judge(_taskId, true);
        bytes32 painting = "painting";
        vm.prank(admin);
        organization.allowKind(painting, Review.Auditor, 0);
        TaskRequest memory r = request(100 ether);
        r.kind = painting;
        vm.prank(alice);
        _taskId = tasks.registerTask(r);
        vm.prank(robot1);
        services.registerService(painting, 80 ether, NO_LIMIT, true, "");
        submit(_taskId);
        vm.startPrank(admin);
        organization.setAudit(painting, 1 minutes, Silence.Creator);
        organization.allowKind(painting, Review.Oracle, RULES);
        vm.stopPrank();
        _assertRefused(
            abi.encodeWithSelector(ITaskManager.AuditorMustDecide.selector, _taskId, oracle),
            oracle,
            Verdict.Undecided,
            0
        );
        judgeAs(oracle, _taskId, Verdict.Accepted, 80 ether);
        assertState(_taskId, TaskState.Settled);
    }

    function test_attack_aPenaltyAfterUndecided() public {
        setTerms(50 ether, 20 ether, 1);
        ServiceId serviceId = offer(robot2Funded(), 10 ether);
        _taskId = post(bob, 100 ether);
        assertEq(tasks.task(_taskId).serviceId, serviceId);
        submit(_taskId);
        _undecide();
        uint256 treasury = coin.balanceOf(address(organization));
        judgeAs(auditor, _taskId, Verdict.Rejected, 0);
        assertEq(services.service(serviceId).bond, 50 ether);
        assertEq(services.service(serviceId).failures, 0);
        assertEq(coin.balanceOf(address(organization)), treasury);
    }

    function robot2Funded() private returns (address) {
        vm.prank(bob);
        coin.transfer(robot2, 50 ether);
        vm.prank(robot2);
        coin.approve(address(tasks), 50 ether);
        return robot2;
    }

    function test_attack_whoRetiresWhileTheAuditorsLookIsPaidAndHasItsBond() public {
        setTerms(50 ether, 20 ether, 1);
        ServiceId serviceId = offer(robot2Funded(), 10 ether);
        _taskId = post(bob, 100 ether);
        submit(_taskId);
        update(serviceId, 10 ether, ServiceState.Retired);
        assertEq(coin.balanceOf(robot2), 0);
        _undecide();
        assertEq(coin.balanceOf(robot2), 50 ether);
        _expire();
        assertEq(coin.balanceOf(robot2), 60 ether);
    }

    function test_anUndecidedTaskIsNeitherCancelledNorProvedAgain() public {
        _undecide();
        bytes memory refusal = abi.encodeWithSelector(
            ITaskManager.WrongState.selector, _taskId, TaskState.Undecided, TaskState.Open
        );
        vm.expectRevert(refusal);
        vm.prank(alice);
        tasks.cancelTask(_taskId);
        vm.expectRevert(refusal);
        tasks.matchTask(_taskId);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, _taskId, TaskState.Undecided, TaskState.Assigned
            )
        );
        vm.prank(robot1);
        tasks.submitProof(_taskId, 1, PROOF, URI);
    }
}
