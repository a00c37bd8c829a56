// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20Errors} from "@openzeppelin/contracts/interfaces/draft-IERC6093.sol";
import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {IOrganization} from "../src/interfaces/IOrganization.sol";
import {IServiceManager, Service, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {Fault, Cause, ITaskManager, TaskRequest, TaskState, Ruling} from "../src/interfaces/ITaskManager.sol";
import {Texts} from "../src/libraries/Texts.sol";
import {Units} from "../src/libraries/Units.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {Finding, IJudge} from "../src/interfaces/IJudge.sol";
import {RoleJudge} from "../src/judges/RoleJudge.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {ORACLE_ROLE} from "../src/types/Roles.sol";
import {Fixture} from "./Fixture.sol";

contract TaskManagerTest is Fixture {
    // -- the money path -----------------------------------------------------------------------------------

    function test_acceptedWorkPaysThePriceAndReturnsTheSurplus() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        assertAssigned(taskId, serviceId);
        assertEq(coin.balanceOf(address(tasks)), 100 ether);

        submit(taskId);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskSettled(taskId, robot1, 80 ether, 20 ether);
        // Who worked is paid first.
        vm.expectEmit(address(coin));
        emit IERC20.Transfer(address(tasks), robot1, 80 ether);
        vm.expectEmit(address(coin));
        emit IERC20.Transfer(address(tasks), alice, 20 ether);
        judge(taskId, true);

        assertState(taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), 2080 ether);
        assertEq(coin.balanceOf(alice), 1920 ether);
        assertEq(coin.balanceOf(address(tasks)), 0);
    }

    function test_aFreeServiceReturnsTheWholeReward() public {
        offer(robot1, 0);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        judge(taskId, true);
        assertEq(coin.balanceOf(robot1), 2000 ether);
        assertEq(coin.balanceOf(alice), 2000 ether);
    }

    function test_theAgreedPriceHoldsWhateverTheProviderAsksLater() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.prank(robot1);
        services.updateService(serviceId, 100 ether, ServiceState.Active);
        submit(taskId);
        judge(taskId, true);
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    function test_registeringWithoutTheMoneyChangesNothing() public {
        vm.expectRevert(
            abi.encodeWithSelector(
                IERC20Errors.ERC20InsufficientBalance.selector, alice, 2000 ether, 2001 ether
            )
        );
        post(alice, 2001 ether);
        assertEq(tasks.taskCount(), 0);
    }

    function test_registeringWithoutApprovalIsRefused() public {
        vm.expectRevert(
            abi.encodeWithSelector(
                IERC20Errors.ERC20InsufficientAllowance.selector, address(tasks), 0, 1 ether
            )
        );
        post(stranger, 1 ether);
    }

    function testFuzz_everyRewardIsSplitWithoutRest(uint256 reward, uint256 price, bool accepted) public {
        reward = bound(reward, 0, 2000 ether);
        price = bound(price, 0, 2000 gwei) * 1 gwei;
        ServiceId serviceId = offer(robot1, price);
        TaskId taskId = post(alice, reward);
        if (Units.levelFor(price, 1 gwei) > Units.levelOf(reward, 1 gwei)) {
            assertState(taskId, TaskState.Open);
            vm.prank(alice);
            tasks.cancelTask(taskId);
            assertEq(coin.balanceOf(alice), 2000 ether);
            return;
        }
        assertAssigned(taskId, serviceId);
        submit(taskId);
        judge(taskId, accepted);
        if (accepted) {
            assertEq(coin.balanceOf(robot1), 2000 ether + price);
            assertEq(coin.balanceOf(alice), 2000 ether - price);
            assertEq(coin.balanceOf(address(tasks)), 0);
        } else {
            assertEq(coin.balanceOf(address(tasks)), reward);
        }
    }

    // -- requests -----------------------------------------------------------------------------------------

    function test_anUnknownKindIsRefused() public {
        TaskRequest memory r = request(1 ether);
        r.kind = "painting";
        vm.expectRevert(abi.encodeWithSelector(IOrganization.UnknownKind.selector, bytes32("painting")));
        vm.prank(alice);
        tasks.registerTask(r);
    }

    function test_windowsAndAttemptsAreBounded() public {
        (uint32 min, uint32 max) = (SHORTEST, 30 days);
        TaskRequest memory r = request(1 ether);
        uint32[2] memory windows = [min - 1, max + 1];
        for (uint256 i = 0; i < 2; ++i) {
            r.executionWindow = windows[i];
            vm.expectRevert(
                abi.encodeWithSelector(IOrganization.InvalidWindow.selector, CLEANING, windows[i], min, max)
            );
            vm.prank(alice);
            tasks.registerTask(r);
        }

        for (uint8 attempts = 0; attempts <= 8; attempts += 8) {
            r = request(1 ether);
            r.maxAttempts = attempts;
            vm.expectRevert(abi.encodeWithSelector(ITaskManager.InvalidAttempts.selector, attempts, 7));
            vm.prank(alice);
            tasks.registerTask(r);
        }
    }

    function test_aTaskThatDoesNotExistIsUnknown() public {
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.UnknownTask.selector, 7));
        tasks.task(taskNo(7));
    }

    // -- cancelling ---------------------------------------------------------------------------------------

    function test_theCreatorCancelsAnOpenTaskForAFullRefund() public {
        TaskId taskId = post(alice, 100 ether);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskCancelled(taskId, 100 ether);
        vm.prank(alice);
        tasks.cancelTask(taskId);
        assertState(taskId, TaskState.Cancelled);
        assertEq(coin.balanceOf(alice), 2000 ether);
        // It has left the queue as well.
        ServiceId serviceId = offer(robot1, 1 ether);
        assertEq(services.service(serviceId).taskId, 0);
    }

    function test_aStrangerCannotCancel() public {
        TaskId taskId = post(alice, 100 ether);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotCreator.selector, taskId, stranger, alice));
        vm.prank(stranger);
        tasks.cancelTask(taskId);
    }

    function test_nobodyCancelsARunningTask() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, taskId, TaskState.Assigned, TaskState.Open
            )
        );
        vm.prank(alice);
        tasks.cancelTask(taskId);
        submit(taskId);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, taskId, TaskState.Submitted, TaskState.Open
            )
        );
        vm.prank(alice);
        tasks.cancelTask(taskId);
    }

    function test_aTaskIsCancelledOnce() public {
        TaskId taskId = post(alice, 100 ether);
        vm.startPrank(alice);
        tasks.cancelTask(taskId);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, taskId, TaskState.Cancelled, TaskState.Open
            )
        );
        tasks.cancelTask(taskId);
    }

    // -- proofs -------------------------------------------------------------------------------------------

    function test_onlyTheExecutorSubmits() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotExecutor.selector, taskId, robot2, robot1));
        vm.prank(robot2);
        tasks.submitProof(taskId, 1, PROOF, URI);
    }

    function test_aProofIsSubmittedOnce() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, taskId, TaskState.Submitted, TaskState.Assigned
            )
        );
        vm.prank(robot1);
        tasks.submitProof(taskId, 1, keccak256("another"), URI);
        assertEq(tasks.task(taskId).proofHash, PROOF);
    }

    function test_aProofNamesTheRunningAttempt() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.WrongAttempt.selector, taskId, 1, 2));
        vm.prank(robot1);
        tasks.submitProof(taskId, 2, PROOF, URI);
    }

    function test_anEmptyProofIsRefused() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.EmptyProof.selector, taskId));
        vm.prank(robot1);
        tasks.submitProof(taskId, 1, 0, URI);
    }

    function test_theLastSecondOfTheExecutionWindowCountsAndTheNextDoesNot() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        uint256 deadline = block.timestamp + WINDOW;
        vm.warp(deadline + 1);
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.DeadlinePassed.selector, taskId, deadline, deadline + 1)
        );
        vm.prank(robot1);
        tasks.submitProof(taskId, 1, PROOF, URI);
        vm.warp(deadline);
        submit(taskId);
        assertState(taskId, TaskState.Submitted);
    }

    // -- verdicts -----------------------------------------------------------------------------------------

    function test_onlyTheOracleDecides() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        vm.expectRevert(abi.encodeWithSelector(RoleJudge.NotInRole.selector, robot1, ORACLE_ROLE));
        vm.prank(robot1);
        oracleJudge.rule(
            Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 1 ether, ""), ""
        );
    }

    function test_withoutAProofThereIsNoVerdict() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, taskId, TaskState.Assigned, TaskState.Submitted
            )
        );
        vm.prank(oracle);
        oracleJudge.rule(Finding(taskId, 1, 0, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 1 ether, ""), "");
    }

    function test_aVerdictNamesTheSubmittedProof() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        bytes32 other = keccak256("other");
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.ProofMismatch.selector, taskId, PROOF, other));
        vm.prank(oracle);
        oracleJudge.rule(
            Finding(taskId, 1, other, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 1 ether, ""), ""
        );
    }

    function test_aVerdictOnAnEarlierAttemptIsRefused() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        judge(taskId, false);
        submit(taskId);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.WrongAttempt.selector, taskId, 2, 1));
        vm.prank(oracle);
        oracleJudge.rule(
            Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 1 ether, ""), ""
        );
    }

    function test_aLateVerdictIsRefused() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        uint256 caseEnd = block.timestamp + WINDOW + AUDIT_WINDOW;
        vm.warp(caseEnd + 1);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.CaseOver.selector, taskId, caseEnd, caseEnd + 1));
        vm.prank(oracle);
        oracleJudge.rule(
            Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 1 ether, ""), ""
        );
    }

    function test_theVerdictIsLoggedWithItsReasonAndReport() public {
        offer(robot1, 1 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        vm.expectEmit(address(oracleJudge));
        emit IJudge.Reported(taskId, "report", "because");
        vm.expectEmit(address(tasks));
        emit ITaskManager.Ruled(taskId, 1, PROOF, Ruling.Rejected, Fault.Nobody, 0, 0, REPORT);
        judge(taskId, false);
    }

    // -- failed attempts ----------------------------------------------------------------------------------

    function test_theLastRejectionRefundsTheCreator() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        for (uint8 attempt = 1; attempt < ATTEMPTS; ++attempt) {
            submit(taskId);
            vm.expectEmit(address(tasks));
            emit ITaskManager.TaskRequeued(taskId, attempt, Cause.Rejected);
            judge(taskId, false);
            assertAssigned(taskId, serviceId);
            assertEq(tasks.task(taskId).attempt, attempt + 1);
            assertEq(tasks.task(taskId).proofHash, 0);
        }
        submit(taskId);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskFailed(taskId, 100 ether, ATTEMPTS, Cause.Rejected);
        judge(taskId, false);

        assertState(taskId, TaskState.Failed);
        assertEq(coin.balanceOf(alice), 2000 ether);
        assertEq(coin.balanceOf(robot1), 2000 ether);
        Service memory s = services.service(serviceId);
        assertEq(s.taskId, 0);
        assertEq(s.rejected, ATTEMPTS);
    }

    function test_anyoneExpiresAnOverdueExecution() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        uint256 deadline = block.timestamp + WINDOW;
        vm.warp(deadline);
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.DeadlineNotPassed.selector, taskId, deadline, deadline)
        );
        tasks.expireTask(taskId);
        vm.warp(deadline + 1);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskRequeued(taskId, 1, Cause.ExecutionExpired);
        vm.prank(stranger);
        tasks.expireTask(taskId);
        assertEq(services.service(serviceId).expired, 1);
    }

    function test_theLastExpiryRefundsTheCreator() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        for (uint8 attempt = 1; attempt <= ATTEMPTS; ++attempt) {
            vm.warp(block.timestamp + WINDOW + 1);
            tasks.expireTask(taskId);
        }
        assertState(taskId, TaskState.Failed);
        assertEq(coin.balanceOf(alice), 2000 ether);
    }

    function test_onlyARunningAttemptExpires() public {
        TaskId taskId = post(alice, 100 ether);
        vm.warp(block.timestamp + 30 days);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, taskId, TaskState.Open, TaskState.Assigned
            )
        );
        tasks.expireTask(taskId);
    }

    function test_aTerminalTaskStaysAsItIs() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        judge(taskId, true);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, taskId, TaskState.Settled, TaskState.Submitted
            )
        );
        vm.prank(oracle);
        oracleJudge.rule(
            Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 1 ether, ""), ""
        );
        vm.warp(block.timestamp + 30 days);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, taskId, TaskState.Settled, TaskState.Assigned
            )
        );
        tasks.expireTask(taskId);
    }

    // -- matching -----------------------------------------------------------------------------------------

    function test_tasksAreServedInOrderOfRegistration() public {
        TaskId first = post(alice, 100 ether);
        TaskId second = post(bob, 100 ether);
        ServiceId serviceId = offer(robot1, 80 ether);
        assertAssigned(first, serviceId);
        assertState(second, TaskState.Open);
        submit(first);
        judge(first, true);
        assertAssigned(second, serviceId);
    }

    function test_theServiceThatWaitedLongestIsServedFirst() public {
        ServiceId one = offer(robot1, 80 ether);
        ServiceId two = offer(robot2, 80 ether);
        TaskId a = post(alice, 100 ether);
        TaskId b = post(alice, 100 ether);
        assertAssigned(a, one);
        assertAssigned(b, two);
        submit(b);
        judge(b, true);
        submit(a);
        judge(a, true);
        // The second one was free again first.
        assertAssigned(post(alice, 100 ether), two);
        assertAssigned(post(alice, 100 ether), one);
    }

    function test_aPriceAboveTheRewardNeverMatches() public {
        offer(robot1, 100 ether + 1 gwei);
        TaskId taskId = post(alice, 100 ether);
        assertState(taskId, TaskState.Open);
    }

    function test_aTaskThatNobodyCanDoDoesNotBlockThoseBehindIt() public {
        TaskId poor = post(alice, 10 ether);
        TaskId rich = post(bob, 100 ether);
        ServiceId serviceId = offer(robot1, 80 ether);
        assertState(poor, TaskState.Open);
        assertAssigned(rich, serviceId);
    }

    function test_aServiceThatIsTooDearDoesNotBlockThoseBehindIt() public {
        offer(robot1, 80 ether);
        ServiceId cheap = offer(robot2, 10 ether);
        assertAssigned(post(alice, 50 ether), cheap);
    }

    function test_kindsDoNotMix() public {
        vm.prank(robot1);
        services.registerService(CHARGING, 10 ether, NO_LIMIT, true, "");
        assertState(post(alice, 100 ether), TaskState.Open);
    }

    function test_aRequeuedTaskIsBackInItsOldPlace() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId first = post(alice, 100 ether);
        TaskId second = post(bob, 100 ether);
        submit(first);
        judge(first, false);
        assertAssigned(first, serviceId);
        assertState(second, TaskState.Open);
    }

    function test_aFailedAttemptIsRetriedByAnotherServiceFirst() public {
        ServiceId one = offer(robot1, 80 ether);
        ServiceId two = offer(robot2, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        assertAssigned(taskId, one);
        submit(taskId);
        judge(taskId, false);
        assertAssigned(taskId, two);
        assertEq(services.service(one).taskId, 0);
    }

    function test_aRequeuedTaskWaitsBehindOlderOnes() public {
        TaskId poor = post(alice, 10 ether);
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId rich = post(bob, 100 ether);
        assertAssigned(rich, serviceId);
        vm.prank(robot1);
        services.updateService(serviceId, 5 ether, ServiceState.Active);
        submit(rich);
        judge(rich, false);
        // The provider got cheaper meanwhile, so the older task is now within its reach.
        assertAssigned(poor, serviceId);
        assertState(rich, TaskState.Open);
    }

    function test_theNonceCannotBeKnownBeforeTheAssignment() public {
        offer(robot1, 1 ether);
        vm.recordLogs();
        uint256 snapshot = vm.snapshotState();
        vm.prevrandao(uint256(1));
        post(alice, 100 ether);
        bytes memory one = vm.getRecordedLogs()[1].data;
        vm.revertToState(snapshot);
        vm.prevrandao(uint256(2));
        post(alice, 100 ether);
        bytes memory two = vm.getRecordedLogs()[1].data;
        assertNotEq(keccak256(one), keccak256(two));
    }

    // -- texts --------------------------------------------------------------------------------------------

    function test_textsAreBounded() public {
        string memory long = new string(8193);
        bytes memory refusal = abi.encodeWithSelector(Texts.TextTooLong.selector, 8193, 8192);
        vm.expectRevert(refusal);
        vm.prank(robot1);
        services.registerService(CLEANING, 1 ether, NO_LIMIT, true, long);

        offer(robot1, 1 ether);
        TaskRequest memory r = request(1 ether);
        r.params = new string(16_385);
        vm.expectRevert(abi.encodeWithSelector(Texts.TextTooLong.selector, 16_385, 16_384));
        vm.prank(alice);
        tasks.registerTask(r);

        r.params = new string(16_384);
        vm.prank(alice);
        TaskId taskId = tasks.registerTask(r);
        vm.expectRevert(refusal);
        vm.prank(robot1);
        tasks.submitProof(taskId, 1, PROOF, long);
        submit(taskId);
        vm.startPrank(oracle);
        vm.expectRevert(refusal);
        oracleJudge.rule(
            Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 1 ether, ""), long
        );
        vm.expectRevert(refusal);
        oracleJudge.rule(
            Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 1 ether, long), ""
        );
        oracleJudge.rule(
            Finding(
                taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 1 ether, new string(8192)
            ),
            new string(8192)
        );
    }

    // -- wiring -------------------------------------------------------------------------------------------

    function test_onlyTheServiceManagerPlacesServices() public {
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotServiceManager.selector, stranger));
        vm.prank(stranger);
        tasks.onServiceFree(serviceNo(1));
    }

    function test_contractsThatDoNotNameEachOtherAreRefused() public {
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.NotWired.selector, address(organization), address(services))
        );
        deployed("TaskManager", abi.encode(organization, IServiceManager(address(services))));
    }
}
