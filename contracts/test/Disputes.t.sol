// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {SafeCast} from "@openzeppelin/contracts/utils/math/SafeCast.sol";
import {OracleCommittee} from "../src/OracleCommittee.sol";
import {IDisputes, Instance, Ruling} from "../src/interfaces/IDisputes.sol";
import {IOracleCommittee, Judge, Vote} from "../src/interfaces/IOracleCommittee.sol";
import {ITaskManager, TaskRequest, TaskState, Verdict} from "../src/interfaces/ITaskManager.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Instances} from "./Instances.sol";

contract Burner {
    fallback() external {
        while (true) {}
    }
}

contract DisputesTest is Instances {
    // -- nobody objects ---------------------------------------------------------------------------------------

    function test_aVerdictWaitsForItsWindow() public {
        Vote memory vote = ruled(Verdict.Accepted);
        assertState(vote.taskId, TaskState.Submitted);
        (Ruling[] memory rulings, bool challenged, uint256 until) = disputes.caseOf(vote.taskId);
        assertEq(rulings.length, 1);
        assertFalse(challenged);
        assertEq(until, block.timestamp + CHALLENGE);
        vm.expectRevert(
            abi.encodeWithSelector(IDisputes.WindowNotOver.selector, vote.taskId, until, block.timestamp)
        );
        disputes.close(vote, REPORT_URI);
    }

    function test_anybodyPostsItAfterwards() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 before = coin.balanceOf(robot1);
        skip(CHALLENGE + 1);
        vm.expectEmit(address(tasks));
        emit ITaskManager.VerdictPosted(
            vote.taskId, 1, PROOF, Verdict.Accepted, 80 ether, REPORT, REPORT_URI, "accepted"
        );
        vm.prank(stranger);
        disputes.close(vote, REPORT_URI);
        assertState(vote.taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), before + 80 ether);
        assertEmpty(vote.taskId);
    }

    function test_nobodyPostsAnotherVerdictThanTheJudges() public {
        Vote memory vote = ruled(Verdict.Rejected);
        skip(CHALLENGE + 1);
        for (uint256 part = 0; part < 4; ++part) {
            Vote memory other = voteOf(vote.taskId, part == 0 ? Verdict.Accepted : Verdict.Rejected);
            if (part == 1) other.reason = "another";
            if (part == 2) other.reportHash = "another";
            vm.expectPartialRevert(IDisputes.OtherVerdict.selector);
            disputes.close(other, part == 3 ? "another" : REPORT_URI);
        }
    }

    function test_oneInstanceAloneJudgesAtOnce() public {
        Instance[] memory one = new Instance[](1);
        one[0] = Instance(committee, 0, 0, 0, 0);
        setInstances(one);
        Vote memory vote = ruled(Verdict.Accepted);
        assertState(vote.taskId, TaskState.Settled);
    }

    function test_whatIsUndecidedGoesToTheAuditorsAtOnce() public {
        Vote memory vote = ruled(Verdict.Undecided);
        assertState(vote.taskId, TaskState.Undecided);
        assertEmpty(vote.taskId);
    }

    function test_whatIsUndecidedIsNeverTooLateForTheAuditors() public {
        TaskId taskId = waiting();
        vm.warp(tasks.task(taskId).deadline);
        Vote memory vote = voteOf(taskId, Verdict.Undecided);
        disputes.postVotes(vote, REPORT_URI, signatures(vote, 3));
        assertState(taskId, TaskState.Undecided);
    }

    // -- who may judge, and when ----------------------------------------------------------------------------

    function test_noCommitteeGoesPastTheWindow() public {
        Vote memory vote = voteOf(waiting(), Verdict.Accepted);
        bytes memory votes = signedBy(committee, judgeKeys[0], vote);
        votes = abi.encodePacked(
            votes, signedBy(committee, judgeKeys[1], vote), signedBy(committee, judgeKeys[2], vote)
        );
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotJudge.selector, address(committee), CLEANING));
        committee.postVotes(vote, REPORT_URI, votes);
    }

    function test_votesThatAreNoVerdictAreNoneHere() public {
        Vote memory vote = voteOf(waiting(), Verdict.Accepted);
        bytes memory votes = signedBy(committee, judgeKeys[0], vote);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.TooFewVotes.selector, vote.taskId, 1, VOTES));
        disputes.postVotes(vote, REPORT_URI, votes);
    }

    function test_nobodyElseCountsVotes() public {
        Vote memory vote = voteOf(waiting(), Verdict.Accepted);
        vm.prank(stranger);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotJudge.selector, stranger, CLEANING));
        committee.countVoters(vote, "");
    }

    function test_aVerdictStandsUntilItIsChallenged() public {
        Vote memory vote = ruled(Verdict.Accepted);
        Vote memory other = voteOf(vote.taskId, Verdict.Rejected);
        bytes memory votes = by(second, secondKeys, 4, other);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NotChallenged.selector, vote.taskId));
        disputes.postVotes(other, REPORT_URI, votes);
    }

    function test_theFirstJudgesDoNotDecideAboutThemselves() public {
        Vote memory vote = ruled(Verdict.Accepted);
        challenge(alice, vote.taskId);
        bytes memory votes = signatures(vote, 5);
        vm.expectPartialRevert(IOracleCommittee.NotAJudge.selector);
        disputes.postVotes(vote, REPORT_URI, votes);
    }

    function test_whoDecidesAChallengeHasTo() public {
        Vote memory vote = ruled(Verdict.Accepted);
        challenge(alice, vote.taskId);
        vote = voteOf(vote.taskId, Verdict.Undecided);
        bytes memory votes = by(second, secondKeys, 4, vote);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.MustDecide.selector, vote.taskId));
        disputes.postVotes(vote, REPORT_URI, votes);
    }

    function test_whatTheTaskManagerWouldRefuseAtTheEndIsRefusedAtOnce() public {
        TaskId taskId = waiting();
        bytes4[6] memory why = [
            ITaskManager.WrongAttempt.selector,
            ITaskManager.ProofMismatch.selector,
            ITaskManager.NoVerdict.selector,
            ITaskManager.InvalidAmount.selector,
            ITaskManager.InvalidAmount.selector,
            ITaskManager.InvalidAmount.selector
        ];
        for (uint256 part = 0; part < 6; ++part) {
            Vote memory vote = voteOf(taskId, Verdict.Accepted);
            if (part == 0) vote.attempt = 2;
            if (part == 1) vote.proofHash = "another";
            if (part == 2) vote.verdict = Verdict.None;
            if (part == 3) vote.amount = 81 ether;
            if (part == 4) vote.amount = 0;
            if (part == 5) vote.verdict = Verdict.Rejected;
            bytes memory votes = signatures(vote, 3);
            vm.expectPartialRevert(why[part]);
            disputes.postVotes(vote, REPORT_URI, votes);
        }
    }

    function test_aFirstVerdictLeavesTimeForTheLast() public {
        TaskId taskId = waiting();
        uint256 longest = disputes.longestCase(CLEANING);
        assertEq(longest, 3 * uint256(CHALLENGE) + 2 * uint256(DECISION));
        uint256 deadline = tasks.task(taskId).deadline;
        vm.warp(deadline - longest + 1);
        Vote memory vote = voteOf(taskId, Verdict.Accepted);
        bytes memory votes = signatures(vote, 3);
        vm.expectRevert(
            abi.encodeWithSelector(IDisputes.TooLate.selector, taskId, block.timestamp + longest, deadline)
        );
        disputes.postVotes(vote, REPORT_URI, votes);
        vm.warp(deadline - longest);
        disputes.postVotes(vote, REPORT_URI, votes);
        // Everybody takes all the time there is.
        skip(CHALLENGE);
        challenge(alice, taskId);
        skip(DECISION);
        decide(second, secondKeys, 4, taskId, Verdict.Rejected);
        skip(CHALLENGE);
        challenge(robot1, taskId);
        skip(DECISION + 1);
        disputes.close(voteOf(taskId, Verdict.Rejected), REPORT_URI);
        assertState(taskId, TaskState.Assigned); // the next attempt
    }

    // -- challenges -------------------------------------------------------------------------------------------

    function test_whoIsRightHasTheStakeBack() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 before = coin.balanceOf(alice);
        challenge(alice, vote.taskId);
        assertEq(coin.balanceOf(alice), before - STAKE);
        decide(second, secondKeys, 4, vote.taskId, Verdict.Rejected);
        skip(CHALLENGE + 1);
        disputes.close(voteOf(vote.taskId, Verdict.Rejected), REPORT_URI);
        assertEq(coin.balanceOf(alice), before);
        assertState(vote.taskId, TaskState.Assigned); // the next attempt
        assertEmpty(vote.taskId);
    }

    function test_whoIsWrongPaysWhomItKeptWaiting() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 creator = coin.balanceOf(alice);
        uint256 executor = coin.balanceOf(robot1);
        challenge(alice, vote.taskId);
        decide(second, secondKeys, 4, vote.taskId, Verdict.Accepted);
        skip(CHALLENGE + 1);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(alice), creator - STAKE + 20 ether); // the rest of its reward
        assertEq(coin.balanceOf(robot1), executor + 80 ether + STAKE);
        assertEmpty(vote.taskId);
    }

    function test_anExecutorChallengesARejection() public {
        Vote memory vote = ruled(Verdict.Rejected);
        uint256 before = coin.balanceOf(robot1);
        challenge(robot1, vote.taskId);
        vote = decide(second, secondKeys, 4, vote.taskId, Verdict.Accepted);
        skip(CHALLENGE + 1);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(robot1), before + 80 ether);
        assertState(vote.taskId, TaskState.Settled);
    }

    function test_aJudgeWhoIsWrongPaysTheOrganization() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 before = coin.balanceOf(address(organization));
        challenge(judges[0], vote.taskId);
        decide(second, secondKeys, 4, vote.taskId, Verdict.Accepted);
        skip(CHALLENGE + 1);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(address(organization)), before + STAKE);
    }

    function test_anOperatorStandsForTheOrganization() public {
        offer(robot1, 80 ether);
        TaskRequest memory wanted = request(100 ether);
        wanted.verdictWindow = VERDICT_WINDOW;
        vm.prank(admin);
        TaskId taskId = organization.registerTask(wanted);
        submit(taskId);
        Vote memory vote = voteOf(taskId, Verdict.Accepted);
        disputes.postVotes(vote, REPORT_URI, signatures(vote, 3));
        vm.prank(bob);
        coin.transfer(admin, STAKE);
        vm.prank(admin);
        coin.approve(address(disputes), STAKE);
        challenge(admin, taskId);
        decide(second, secondKeys, 4, taskId, Verdict.Accepted);
        uint256 before = coin.balanceOf(robot1);
        skip(CHALLENGE + 1);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(robot1), before + 80 ether + STAKE);
    }

    function test_anOperatorStandsForNobodyElse() public {
        Vote memory vote = ruled(Verdict.Accepted);
        vm.prank(admin);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NeitherPartyNorJudge.selector, vote.taskId, admin));
        disputes.challenge(vote.taskId, "wrong");
    }

    function test_anotherAmountIsAnotherVerdict() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 before = coin.balanceOf(alice);
        challenge(alice, vote.taskId);
        vote.amount = 30 ether;
        disputes.postVotes(vote, REPORT_URI, by(second, secondKeys, 4, vote));
        skip(CHALLENGE + 1);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(alice), before + 70 ether);
    }

    function test_aPartyThatTheEndMakesWorseOffWasNotRight() public {
        Vote memory vote = voteOf(waiting(), Verdict.Accepted);
        vote.amount = 50 ether;
        disputes.postVotes(vote, REPORT_URI, signatures(vote, 3));
        (uint256 creator, uint256 executor) = (coin.balanceOf(alice), coin.balanceOf(robot1));
        challenge(robot1, vote.taskId); // wants more
        vote.amount = 10 ether;
        disputes.postVotes(vote, REPORT_URI, by(second, secondKeys, 4, vote));
        skip(CHALLENGE + 1);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(robot1), executor - STAKE + 10 ether);
        assertEq(coin.balanceOf(alice), creator + STAKE + 90 ether);
        assertEmpty(vote.taskId);
    }

    function test_aCreatorWhoPaysMoreAtTheEndWasNotRight() public {
        Vote memory vote = voteOf(waiting(), Verdict.Accepted);
        vote.amount = 10 ether;
        disputes.postVotes(vote, REPORT_URI, signatures(vote, 3));
        uint256 executor = coin.balanceOf(robot1);
        challenge(alice, vote.taskId);
        vote.amount = 50 ether;
        disputes.postVotes(vote, REPORT_URI, by(second, secondKeys, 4, vote));
        skip(CHALLENGE + 1);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(robot1), executor + STAKE + 50 ether);
    }

    /// @dev A little for the work, and a tenth of the price for the trouble: what is better is what pays more.
    function test_aTenthIsMoreThanLittle() public {
        Vote memory little = voteOf(waiting(), Verdict.Accepted);
        little.amount = 1 ether;
        Vote memory tenth = voteOf(little.taskId, Verdict.Impossible); // 8 ether
        address[2] memory challengers = [alice, robot1];
        for (uint256 i = 0; i < 4; ++i) {
            uint256 snapshot = vm.snapshotState();
            (Vote memory first, Vote memory last) = i < 2 ? (little, tenth) : (tenth, little);
            disputes.postVotes(first, REPORT_URI, signatures(first, 3));
            (uint256 creator, uint256 executor) = (coin.balanceOf(alice), coin.balanceOf(robot1));
            challenge(challengers[i % 2], first.taskId);
            disputes.postVotes(last, REPORT_URI, by(second, secondKeys, 4, last));
            skip(CHALLENGE + 1);
            disputes.close(last, REPORT_URI);
            uint256 paid = i < 2 ? 8 ether : 1 ether;
            (uint256 creators, uint256 executors) = (creator + 100 ether - paid, executor + paid);
            if (i == 0) (creators, executors) = (creators - STAKE, executors + STAKE);
            if (i == 3) (creators, executors) = (creators + STAKE, executors - STAKE);
            assertEq(coin.balanceOf(alice), creators, "creator");
            assertEq(coin.balanceOf(robot1), executors, "executor");
            vm.revertToState(snapshot);
        }
    }

    function test_ofTheSamePayTheAcceptedWorkIsBetter() public {
        Vote memory vote = ruled(Verdict.Impossible);
        uint256 before = coin.balanceOf(robot1);
        challenge(robot1, vote.taskId);
        vote = voteOf(vote.taskId, Verdict.Accepted);
        vote.amount = 8 ether;
        disputes.postVotes(vote, REPORT_URI, by(second, secondKeys, 4, vote));
        skip(CHALLENGE + 1);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(robot1), before + 8 ether);
    }

    function test_anAppealTakesTheStakeOfWhoIsWrongAtTheEnd() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 creator = coin.balanceOf(alice);
        uint256 executor = coin.balanceOf(robot1);
        challenge(alice, vote.taskId);
        decide(second, secondKeys, 4, vote.taskId, Verdict.Rejected);
        challenge(robot1, vote.taskId);
        decide(third, thirdKeys, 5, vote.taskId, Verdict.Accepted);
        assertState(vote.taskId, TaskState.Settled);
        assertEq(coin.balanceOf(alice), creator - STAKE + 20 ether);
        assertEq(coin.balanceOf(robot1), executor + STAKE + 80 ether);
        assertEmpty(vote.taskId);
    }

    function test_anAppealThatFailsPaysTheChallenger() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 creator = coin.balanceOf(alice);
        challenge(alice, vote.taskId);
        decide(second, secondKeys, 4, vote.taskId, Verdict.Rejected);
        challenge(robot1, vote.taskId);
        decide(third, thirdKeys, 5, vote.taskId, Verdict.Rejected);
        assertEq(coin.balanceOf(alice), creator + APPEAL);
        assertEmpty(vote.taskId);
    }

    function test_aSilentInstanceLeavesTheVerdictAndCostsNoStake() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 before = coin.balanceOf(alice);
        challenge(alice, vote.taskId);
        skip(DECISION);
        vm.expectPartialRevert(IDisputes.WindowNotOver.selector);
        disputes.close(vote, REPORT_URI);
        skip(1);
        bytes memory votes = by(second, secondKeys, 4, vote);
        vm.expectPartialRevert(IDisputes.WindowOver.selector);
        disputes.postVotes(vote, REPORT_URI, votes);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(alice), before + 20 ether);
        assertState(vote.taskId, TaskState.Settled);
        assertEmpty(vote.taskId);
    }

    function test_whoIsNeitherPartyNorJudgeDoesNotChallenge() public {
        Vote memory vote = ruled(Verdict.Accepted);
        vm.prank(stranger);
        vm.expectRevert(
            abi.encodeWithSelector(IDisputes.NeitherPartyNorJudge.selector, vote.taskId, stranger)
        );
        disputes.challenge(vote.taskId, "wrong");
    }

    function test_aJudgeOfAnotherKindDoesNotChallenge() public {
        setQuorum(2, 3, 0, 0x0e); // without judge 0
        Instance[] memory wanted = three();
        setInstances(wanted);
        TaskId taskId = waiting();
        Vote memory vote = voteOf(taskId, Verdict.Accepted);
        disputes.postVotes(
            vote, REPORT_URI, abi.encodePacked(sign(judgeKeys[1], vote), sign(judgeKeys[2], vote))
        );
        vm.prank(judges[0]);
        vm.expectPartialRevert(IDisputes.NeitherPartyNorJudge.selector);
        disputes.challenge(taskId, "wrong");
    }

    function test_aVerdictIsChallengedOnceAndInTime() public {
        Vote memory vote = ruled(Verdict.Accepted);
        challenge(alice, vote.taskId);
        vm.prank(robot1);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.ChallengedBefore.selector, vote.taskId, alice));
        disputes.challenge(vote.taskId, "wrong");
        decide(second, secondKeys, 4, vote.taskId, Verdict.Accepted);
        skip(CHALLENGE + 1);
        vm.prank(alice);
        vm.expectPartialRevert(IDisputes.WindowOver.selector);
        disputes.challenge(vote.taskId, "wrong");
    }

    function test_withoutStakeOrVerdictThereIsNoChallenge() public {
        TaskId taskId = waiting();
        vm.prank(alice);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NoCase.selector, taskId));
        disputes.challenge(taskId, "wrong");
        Vote memory vote = voteOf(taskId, Verdict.Accepted);
        disputes.postVotes(vote, REPORT_URI, signatures(vote, 3));
        vm.startPrank(alice);
        coin.approve(address(disputes), STAKE - 1);
        vm.expectRevert();
        disputes.challenge(taskId, "wrong");
        vm.stopPrank();
    }

    // -- what ends in another way -------------------------------------------------------------------------------

    function test_whereNobodyClosesTheTaskExpiresAndStakesGoBack() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 before = coin.balanceOf(alice);
        challenge(alice, vote.taskId);
        vm.warp(tasks.task(vote.taskId).deadline + 1);
        tasks.expireTask(vote.taskId);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(alice), before + 20 ether); // silence pays the executor
        assertEmpty(vote.taskId);
    }

    function test_afterTheDeadlineStakesGoBackBeforeTheTaskExpires() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 before = coin.balanceOf(alice);
        challenge(alice, vote.taskId);
        vm.warp(tasks.task(vote.taskId).deadline + 1);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(alice), before);
        assertState(vote.taskId, TaskState.Submitted);
    }

    function test_aCaseOfAnEarlierAttemptDoesNotHoldUpTheNext() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 before = coin.balanceOf(alice);
        challenge(alice, vote.taskId);
        // An oracle that may judge, too, by mistake.
        bytes32 role = organization.ORACLE_ROLE();
        vm.prank(admin);
        organization.grantRole(role, oracle);
        judge(vote.taskId, false);
        submit(vote.taskId);
        vm.prank(alice);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NoCase.selector, vote.taskId));
        disputes.challenge(vote.taskId, "wrong");
        Vote memory next = voteOf(vote.taskId, Verdict.Accepted);
        disputes.postVotes(next, REPORT_URI, signatures(next, 3));
        assertEq(coin.balanceOf(alice), before);
        skip(CHALLENGE + 1);
        disputes.close(next, REPORT_URI);
        assertState(vote.taskId, TaskState.Settled);
    }

    function test_withoutItsRoleItKeepsNoStake() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 before = coin.balanceOf(alice);
        challenge(alice, vote.taskId);
        bytes32 role = organization.ORACLE_ROLE();
        vm.prank(admin);
        organization.revokeRole(role, address(disputes));
        skip(DECISION + 1);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotJudge.selector, address(disputes), CLEANING));
        disputes.close(vote, REPORT_URI);
        vm.warp(tasks.task(vote.taskId).deadline + 1);
        disputes.close(vote, REPORT_URI);
        assertEq(coin.balanceOf(alice), before);
    }

    function test_aRunningCaseKeepsItsInstances() public {
        Vote memory vote = ruled(Verdict.Accepted);
        Instance[] memory one = new Instance[](1);
        one[0] = Instance(committee, 0, 0, 0, 0);
        setInstances(one);
        challenge(alice, vote.taskId);
        decide(second, secondKeys, 4, vote.taskId, Verdict.Rejected);
        challenge(robot1, vote.taskId);
        decide(third, thirdKeys, 5, vote.taskId, Verdict.Accepted);
        assertState(vote.taskId, TaskState.Settled);
        assertEmpty(vote.taskId);
    }

    function test_aTokenThatRefusesHoldsUpNoCase() public {
        Vote memory vote = ruled(Verdict.Accepted);
        challenge(alice, vote.taskId);
        vm.mockCall(address(coin), abi.encodeCall(coin.transfer, (alice, STAKE)), abi.encode(false));
        skip(DECISION + 1);
        disputes.close(vote, REPORT_URI);
        assertState(vote.taskId, TaskState.Settled);
        assertEq(disputes.pendingPayments(alice), STAKE);
        vm.clearMockedCalls();
        uint256 before = coin.balanceOf(alice);
        disputes.withdrawPayments(alice);
        assertEq(coin.balanceOf(alice), before + STAKE);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NothingOwed.selector, alice));
        disputes.withdrawPayments(alice);
    }

    /// @dev A token that calls whom it pays. Burning its gas, the executor would have the verdict miss its window.
    function test_aRecipientThatBurnsAllGasHoldsUpNoCase() public {
        Vote memory vote = ruled(Verdict.Rejected);
        challenge(alice, vote.taskId);
        Vote memory same = voteOf(vote.taskId, Verdict.Rejected);
        disputes.postVotes(same, REPORT_URI, by(second, secondKeys, 4, same));
        skip(CHALLENGE + 1);
        bytes memory payment = abi.encodeCall(coin.transfer, (robot1, uint256(STAKE)));
        vm.mockFunction(address(coin), address(new Burner()), payment);
        disputes.close{gas: 3_000_000}(same, REPORT_URI);
        assertEq(tasks.task(vote.taskId).attempt, 2, "rejected");
        assertEq(disputes.pendingPayments(robot1), STAKE);
    }

    // -- instances --------------------------------------------------------------------------------------------

    function test_onlyTheAdministratorSaysWhoJudges() public {
        Instance[] memory wanted = three();
        vm.prank(stranger);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NotAdministrator.selector, stranger));
        disputes.setInstances(CLEANING, wanted);
    }

    function test_laterInstancesAreOthersAndMore() public {
        for (uint256 part = 0; part < 10; ++part) {
            Instance[] memory some = three();
            if (part == 0) some[0].window = 59;
            if (part == 1) some[0].stake = 0;
            if (part == 2) some[0].decision = 1;
            if (part == 3) some[1].decision = 0;
            if (part == 4) some[1].stake = STAKE;
            if (part == 5) some[2].window = CHALLENGE;
            if (part == 6) (some[1].committee, some[2].committee) = (third, second);
            if (part == 7) some[0].window = 7 days + 1;
            if (part == 8) some[2].stake = 1;
            if (part == 9) some[2].judgeStake = 1;
            vm.prank(admin);
            vm.expectPartialRevert(IDisputes.InvalidInstances.selector);
            disputes.setInstances(CLEANING, some);
        }
        Instance[] memory wanted = three();
        vm.startPrank(admin);
        second.seat(judges[0], judges[0]);
        second.setQuorum(CLEANING, 5, 8, 0, 255);
        third.setQuorum(CLEANING, 6, 9, 0, 511);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.JudgesTwice.selector, CLEANING, judges[0]));
        disputes.setInstances(CLEANING, wanted);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.InvalidInstances.selector, CLEANING, 0));
        disputes.setInstances(CLEANING, new Instance[](0));
        vm.stopPrank();
    }

    function test_noCreatorChoosesAWindowInWhichNoCaseEnds() public {
        uint32 longest = uint32(disputes.longestCase(CLEANING));
        Instance[] memory wanted = three();
        vm.startPrank(admin);
        organization.setVerdictWindows(CLEANING, longest, 1 days);
        vm.expectRevert(
            abi.encodeWithSelector(
                IDisputes.VerdictWindowTooShort.selector, CLEANING, longest, uint256(longest)
            )
        );
        disputes.setInstances(CLEANING, wanted);
        organization.setVerdictWindows(CLEANING, longest + 1, 1 days);
        disputes.setInstances(CLEANING, wanted);
        vm.stopPrank();
    }

    function test_aTaskWithAnEarlierShorterWindowIsJudgedAtOnce() public {
        Instance[] memory wanted = three();
        Instance[] memory one = new Instance[](1);
        one[0] = Instance(committee, 0, 0, 0, 0);
        setInstances(one);
        vm.prank(admin);
        organization.setVerdictWindows(CLEANING, 15 minutes, 1 days);
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether); // one hour
        submit(taskId);
        vm.startPrank(admin);
        organization.setVerdictWindows(CLEANING, 2 hours, 1 days);
        disputes.setInstances(CLEANING, wanted);
        vm.stopPrank();
        skip(WINDOW);
        Vote memory vote = voteOf(taskId, Verdict.Accepted);
        disputes.postVotes(vote, REPORT_URI, signatures(vote, 3));
        assertState(taskId, TaskState.Settled);
    }

    function test_aKindWithoutInstancesIsNotJudgedHere() public {
        vm.prank(robot1);
        services.registerService(CHARGING, 1 ether, NO_LIMIT, true, "");
        vm.prank(alice);
        TaskId taskId = tasks.registerTask(
            TaskRequest(CHARGING, 2 ether, WINDOW, WINDOW, ATTEMPTS, 0, 0, address(0), "{}")
        );
        submit(taskId);
        Vote memory vote = voteOf(taskId, Verdict.Accepted);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.KindWithoutInstances.selector, CHARGING));
        disputes.postVotes(vote, REPORT_URI, "");
    }

    // -- whatever they do -------------------------------------------------------------------------------------

    /// @dev Each step is one byte: who acts, and how. Nothing is kept, nothing is made, and the case ends.
    function testFuzz_stakesComeBackToTheWei(bytes32 steps) public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 total = everything();
        address[3] memory parties = [alice, robot1, judges[0]];
        Verdict[3] memory verdicts = [Verdict.Accepted, Verdict.Rejected, Verdict.Impossible];
        Vote memory standing = vote;
        for (uint256 i = 0; i < 12; ++i) {
            uint8 step = uint8(steps[i]);
            (Ruling[] memory rulings, bool challenged,) = disputes.caseOf(vote.taskId);
            if (rulings.length == 0) break;
            skip(step % 5 == 4 ? DECISION : CHALLENGE / 2);
            if (step % 5 == 0) {
                vm.prank(parties[(step / 5) % 3]);
                try disputes.challenge(vote.taskId, "wrong") {} catch {}
            } else if (step % 5 < 3 && challenged) {
                Vote memory next = voteOf(vote.taskId, verdicts[(step / 5) % 3]);
                bytes memory votes =
                    rulings.length == 1 ? by(second, secondKeys, 4, next) : by(third, thirdKeys, 5, next);
                try disputes.postVotes(next, REPORT_URI, votes) {
                    standing = next;
                } catch {}
            } else if (step % 5 == 3) {
                try disputes.close(standing, REPORT_URI) {} catch {}
            }
        }
        (Ruling[] memory left,,) = disputes.caseOf(vote.taskId);
        if (left.length != 0) {
            skip(DECISION + 1);
            disputes.close(standing, REPORT_URI);
        }
        assertEmpty(vote.taskId);
        assertEq(everything(), total);
    }
}

/// @notice A contract that calls itself a committee. Whoever made it says at any time who owns its only judge.
contract PretendedCommittee {
    IDisputes private immutable _disputes;
    address public owner;

    constructor(IDisputes disputes) {
        _disputes = disputes;
    }

    function setOwner(address owner_) external {
        owner = owner_;
    }

    function keyOf(uint8) external pure returns (address) {
        return address(1);
    }

    /// @dev Takes the stake once more while it is paid out, if it can.
    function judge(address) external returns (Judge memory) {
        try _disputes.withdrawStake{gas: 200_000}(IOracleCommittee(address(this)), 0) {} catch {}
        return Judge(owner, 0);
    }
}

contract JudgeStakesTest is Instances {
    address private immutable owner = makeAddr("owner");

    function setUp() public override {
        super.setUp();
        deal(address(coin), stranger, 1000 ether);
        setInstances(threeWithStakes());
        for (uint8 seat = 0; seat < JUDGES; ++seat) {
            deposit(committee, seat);
        }
        for (uint8 seat = 0; seat < 7; ++seat) {
            deposit(second, seat);
        }
    }

    // -- votes ------------------------------------------------------------------------------------------------

    function test_eachVoteNeedsTheStakeOfItsJudge() public {
        announce(2, 1);
        Vote memory vote = voteOf(waiting(), Verdict.Accepted);
        bytes memory votes = signatures(vote, 3);
        vm.expectRevert(
            abi.encodeWithSelector(
                IDisputes.StakeTooLow.selector, committee, 2, JUDGE_STAKE - 1, uint256(JUDGE_STAKE)
            )
        );
        disputes.postVotes(vote, REPORT_URI, votes);
        votes = abi.encodePacked(signatures(vote, 2), sign(judgeKeys[3], vote));
        disputes.postVotes(vote, REPORT_URI, votes);
        (Ruling[] memory rulings,,) = disputes.caseOf(vote.taskId);
        assertEq(rulings[0].voters, 11);
    }

    function test_oneStakeStandsForAllCasesOfItsJudge() public {
        for (uint256 i = 0; i < 3; ++i) {
            ruled(Verdict.Accepted);
        }
        assertStake(committee, 0, JUDGE_STAKE, 0);
    }

    function test_nobodyElseLearnsWhoVoted() public {
        Vote memory vote = voteOf(waiting(), Verdict.Accepted);
        vm.prank(stranger);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotJudge.selector, stranger, CLEANING));
        committee.countVoters(vote, "");
    }

    // -- what a verdict that is overturned costs ----------------------------------------------------------------

    function test_whoVotedForWhatIsOverturnedLosesItsStake() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 treasury = coin.balanceOf(address(organization));
        challenge(alice, vote.taskId);
        decide(second, secondKeys, 4, vote.taskId, Verdict.Rejected);
        skip(CHALLENGE + 1);
        for (uint8 seat = 0; seat < 3; ++seat) {
            vm.expectEmit(address(disputes));
            emit IDisputes.StakeLost(vote.taskId, committee, seat, JUDGE_STAKE);
        }
        vm.expectEmit(address(disputes));
        emit IDisputes.StakePaid(vote.taskId, address(organization), 3 * uint256(JUDGE_STAKE));
        disputes.close(voteOf(vote.taskId, Verdict.Rejected), REPORT_URI);
        for (uint8 seat = 0; seat < JUDGES; ++seat) {
            assertStake(committee, seat, seat < 3 ? 0 : JUDGE_STAKE, 0);
        }
        assertStake(second, 0, JUDGE_STAKE, 0);
        assertEq(coin.balanceOf(address(organization)), treasury + 3 * JUDGE_STAKE);
        assertKept();
        // Its votes do not count until somebody adds to it.
        vote = voteOf(vote.taskId, Verdict.Accepted);
        submit(vote.taskId);
        vote.attempt = 2;
        bytes memory votes = signatures(vote, 3);
        vm.expectPartialRevert(IDisputes.StakeTooLow.selector);
        disputes.postVotes(vote, REPORT_URI, votes);
        for (uint8 seat = 0; seat < 3; ++seat) {
            deposit(committee, seat);
        }
        disputes.postVotes(vote, REPORT_URI, votes);
    }

    function test_anotherAmountCostsThemToo() public {
        Vote memory vote = ruled(Verdict.Accepted);
        challenge(alice, vote.taskId);
        vote.amount = 30 ether;
        disputes.postVotes(vote, REPORT_URI, by(second, secondKeys, 4, vote));
        skip(CHALLENGE + 1);
        disputes.close(vote, REPORT_URI);
        assertStake(committee, 0, 0, 0);
        assertKept();
    }

    function test_whoIsRightAtTheEndLosesNothing() public {
        Vote memory vote = ruled(Verdict.Accepted);
        challenge(alice, vote.taskId);
        decide(second, secondKeys, 4, vote.taskId, Verdict.Rejected);
        challenge(robot1, vote.taskId);
        decide(third, thirdKeys, 5, vote.taskId, Verdict.Accepted);
        assertStake(committee, 0, JUDGE_STAKE, 0);
        for (uint8 seat = 0; seat < 7; ++seat) {
            assertStake(second, seat, seat < 4 ? 0 : JUDGE_STAKE, 0);
        }
        assertKept();
    }

    function test_bothLoseWhatTheLastOverturns() public {
        Vote memory vote = ruled(Verdict.Accepted);
        challenge(alice, vote.taskId);
        decide(second, secondKeys, 4, vote.taskId, Verdict.Rejected);
        challenge(robot1, vote.taskId);
        uint256 treasury = coin.balanceOf(address(organization));
        decide(third, thirdKeys, 5, vote.taskId, Verdict.Impossible);
        assertEq(coin.balanceOf(address(organization)), treasury + 7 * JUDGE_STAKE);
        assertKept();
    }

    function test_whatStandsBySilenceCostsNothing() public {
        Vote memory vote = ruled(Verdict.Accepted);
        challenge(alice, vote.taskId);
        skip(DECISION + 1);
        disputes.close(vote, REPORT_URI);
        assertNothingLost();
    }

    function test_aCaseThatIsVoidCostsNothing() public {
        Vote memory vote = ruled(Verdict.Accepted);
        challenge(alice, vote.taskId);
        decide(second, secondKeys, 4, vote.taskId, Verdict.Rejected);
        vm.warp(tasks.task(vote.taskId).deadline + 1);
        disputes.close(vote, REPORT_URI);
        assertNothingLost();
    }

    function test_whatIsLeftUndecidedCostsNothing() public {
        ruled(Verdict.Undecided);
        assertNothingLost();
    }

    function test_manyCasesCostNoMoreThanThereIs() public {
        Vote[2] memory votes = [ruled(Verdict.Accepted), ruled(Verdict.Accepted)];
        uint256 treasury = coin.balanceOf(address(organization));
        for (uint256 i = 0; i < 2; ++i) {
            challenge(alice, votes[i].taskId);
            votes[i] = decide(second, secondKeys, 4, votes[i].taskId, Verdict.Rejected);
        }
        vm.prank(stranger);
        disputes.depositStake(committee, 1, 2 ether);
        skip(CHALLENGE + 1);
        disputes.close(votes[0], REPORT_URI);
        disputes.close(votes[1], REPORT_URI);
        assertEq(coin.balanceOf(address(organization)), treasury + 3 * JUDGE_STAKE + 2 ether);
        assertKept();
    }

    function test_aRunningCaseKeepsItsStakes() public {
        Vote memory vote = ruled(Verdict.Accepted);
        Instance[] memory others = threeWithStakes();
        (others[0].judgeStake, others[1].judgeStake) = (1 ether, 0);
        setInstances(others);
        for (uint8 seat = 0; seat < 4; ++seat) {
            vm.prank(vm.addr(secondKeys[seat]));
            disputes.announceWithdrawal(second, seat, JUDGE_STAKE);
        }
        challenge(alice, vote.taskId);
        Vote memory other = voteOf(vote.taskId, Verdict.Rejected);
        bytes memory votes = by(second, secondKeys, 4, other);
        vm.expectPartialRevert(IDisputes.StakeTooLow.selector);
        disputes.postVotes(other, REPORT_URI, votes);
        for (uint8 seat = 0; seat < 4; ++seat) {
            deposit(second, seat);
        }
        disputes.postVotes(other, REPORT_URI, votes);
        skip(CHALLENGE + 1);
        disputes.close(other, REPORT_URI);
        assertStake(committee, 0, 0, 0);
    }

    function test_aJudgeOfNoQuorumAnyMoreLosesAllTheSame() public {
        Vote memory vote = ruled(Verdict.Accepted);
        setQuorum(2, 3, 0, 0x1c); // without judges 0 and 1
        overturn(vote.taskId);
        assertStake(committee, 0, 0, 0);
    }

    function test_anotherKeyChangesNothing() public {
        Vote memory vote = ruled(Verdict.Accepted);
        vm.prank(judges[0]);
        committee.changeKey(judges[0], makeAddr("another"));
        assertStake(committee, 0, JUDGE_STAKE, 0);
        overturn(vote.taskId);
        assertStake(committee, 0, 0, 0);
    }

    function test_aTokenThatRefusesTheTreasuryHoldsUpNoCase() public {
        Vote memory vote = ruled(Verdict.Accepted);
        uint256 lost = 3 * uint256(JUDGE_STAKE);
        vm.mockCall(
            address(coin), abi.encodeCall(coin.transfer, (address(organization), lost)), abi.encode(false)
        );
        overturn(vote.taskId);
        vm.clearMockedCalls();
        assertEq(disputes.pendingPayments(address(organization)), lost);
        assertEq(coin.balanceOf(address(disputes)), deposited() + lost);
        uint256 treasury = coin.balanceOf(address(organization));
        disputes.withdrawPayments(address(organization));
        assertEq(coin.balanceOf(address(organization)), treasury + lost);
        assertKept();
    }

    // -- deposits ---------------------------------------------------------------------------------------------

    function test_anybodyDepositsForAJudge() public {
        uint256 before = coin.balanceOf(alice);
        vm.expectEmit(address(disputes));
        emit IDisputes.StakeDeposited(committee, 0, alice, 3 ether);
        vm.prank(alice);
        disputes.depositStake(committee, 0, 3 ether);
        assertStake(committee, 0, JUDGE_STAKE + 3 ether, 0);
        assertEq(coin.balanceOf(alice), before - 3 ether);
        vm.prank(alice);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NotOwner.selector, alice, judges[0]));
        disputes.announceWithdrawal(committee, 0, 3 ether);
    }

    function test_aSeatWithoutJudgeHasNoStake() public {
        vm.startPrank(stranger);
        bytes memory none = abi.encodeWithSelector(IDisputes.NoJudge.selector, committee, JUDGES);
        vm.expectRevert(none);
        disputes.depositStake(committee, JUDGES, 1 ether);
        vm.expectRevert(none);
        disputes.announceWithdrawal(committee, JUDGES, 0);
        vm.expectRevert(none);
        disputes.withdrawStake(committee, JUDGES);
        vm.expectRevert();
        disputes.depositStake(IOracleCommittee(stranger), 0, 1 ether);
        vm.stopPrank();
    }

    function test_aStakeFitsIntoItsWord() public {
        announce(0, JUDGE_STAKE);
        uint256 room = type(uint96).max - JUDGE_STAKE;
        deal(address(coin), stranger, room + 1);
        vm.startPrank(stranger);
        vm.expectRevert(
            abi.encodeWithSelector(
                SafeCast.SafeCastOverflowedUintDowncast.selector, 96, uint256(type(uint96).max) + 1
            )
        );
        disputes.depositStake(committee, 0, room + 1);
        disputes.depositStake(committee, 0, room);
        vm.stopPrank();
        announce(0, room);
        assertStake(committee, 0, 0, type(uint96).max);
    }

    function test_withoutTokensThereIsNoDeposit() public {
        vm.prank(bob); // approved nothing
        vm.expectRevert();
        disputes.depositStake(committee, 0, 1 ether);
        assertStake(committee, 0, JUDGE_STAKE, 0);
    }

    /// @dev As one that begins to take a fee: what it lost on the way would be paid from others' stakes.
    function test_whatDoesNotArriveIsNoStake() public {
        Vote memory vote = ruled(Verdict.Accepted);
        vm.mockCall(address(coin), abi.encodeWithSelector(coin.transferFrom.selector), abi.encode(true));
        vm.startPrank(alice);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.WrongAmountReceived.selector, STAKE, 0));
        disputes.challenge(vote.taskId, "wrong");
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.WrongAmountReceived.selector, 1 ether, 0));
        disputes.depositStake(committee, 0, 1 ether);
        vm.stopPrank();
        assertStake(committee, 0, JUDGE_STAKE, 0);
    }

    // -- withdrawals ------------------------------------------------------------------------------------------

    function test_aStakeLeavesAfterTheLongestCase() public {
        vm.prank(judges[0]);
        services.setPayout(judges[0], owner);
        uint256 until = block.timestamp + disputes.UNBONDING();
        vm.expectEmit(address(disputes));
        emit IDisputes.WithdrawalAnnounced(committee, 0, 2 ether, until);
        announce(0, 2 ether);
        assertStake(committee, 0, JUDGE_STAKE - 2 ether, 2 ether);
        vm.warp(until);
        vm.expectRevert(
            abi.encodeWithSelector(IDisputes.WithdrawalTooEarly.selector, committee, 0, until, until)
        );
        disputes.withdrawStake(committee, 0);
        vm.warp(until + 1);
        vm.expectEmit(address(disputes));
        emit IDisputes.StakeWithdrawn(committee, 0, owner, 2 ether);
        vm.prank(alice); // anybody
        disputes.withdrawStake(committee, 0);
        assertEq(coin.balanceOf(owner), 2 ether);
        assertStake(committee, 0, JUDGE_STAKE - 2 ether, 0);
        assertKept();
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NoWithdrawal.selector, committee, 0));
        disputes.withdrawStake(committee, 0);
    }

    function test_announcingAgainBeginsTheTimeAnew() public {
        announce(0, 2 ether);
        skip(disputes.UNBONDING());
        announce(0, 1 ether);
        skip(1);
        vm.expectPartialRevert(IDisputes.WithdrawalTooEarly.selector);
        disputes.withdrawStake(committee, 0);
        assertStake(committee, 0, JUDGE_STAKE - 3 ether, 3 ether);
    }

    function test_nobodyWithdrawsMoreThanThereIs() public {
        vm.prank(judges[0]);
        vm.expectRevert(
            abi.encodeWithSelector(
                IDisputes.StakeTooLow.selector, committee, 0, uint256(JUDGE_STAKE), JUDGE_STAKE + 1
            )
        );
        disputes.announceWithdrawal(committee, 0, JUDGE_STAKE + 1);
    }

    function test_whoLeavesBeforeItIsOverturnedLosesItsStakeAllTheSame() public {
        Vote memory vote = ruled(Verdict.Accepted);
        announce(0, JUDGE_STAKE - 1 ether);
        announce(1, JUDGE_STAKE);
        vm.prank(stranger);
        disputes.depositStake(committee, 0, 1 ether);
        overturn(vote.taskId);
        assertStake(committee, 0, 0, 1 ether); // first what counts
        assertStake(committee, 1, 0, 0);
        skip(disputes.UNBONDING());
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NoWithdrawal.selector, committee, 1));
        disputes.withdrawStake(committee, 1);
        assertKept();
    }

    function test_noCaseLastsLongerThanAStakeIsKept() public {
        uint32 longest = organization.MAX_VERDICT_WINDOW();
        assertEq(disputes.UNBONDING(), longest);
        vm.prank(admin);
        organization.setVerdictWindows(CLEANING, 2 hours, longest);
        offer(robot1, 80 ether);
        TaskRequest memory wanted = request(100 ether);
        wanted.verdictWindow = longest;
        vm.prank(alice);
        TaskId taskId = tasks.registerTask(wanted);
        submit(taskId);
        Vote memory vote = voteOf(taskId, Verdict.Accepted);
        disputes.postVotes(vote, REPORT_URI, signatures(vote, 3));
        announce(0, JUDGE_STAKE);
        challenge(alice, taskId);
        vote = decide(second, secondKeys, 4, taskId, Verdict.Rejected);
        vm.warp(tasks.task(taskId).deadline);
        vm.expectPartialRevert(IDisputes.WithdrawalTooEarly.selector);
        disputes.withdrawStake(committee, 0);
        disputes.close(vote, REPORT_URI);
        assertStake(committee, 0, 0, 0);
    }

    function test_whoTakesAJudgesKeyDoesNotTakeItsStake() public {
        (address key, uint256 secret) = makeAddrAndKey("key");
        vm.prank(admin);
        committee.seat(key, owner);
        deposit(committee, JUDGES);
        vm.startPrank(vm.addr(secret));
        committee.changeKey(key, stranger);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NotOwner.selector, key, owner));
        disputes.announceWithdrawal(committee, JUDGES, JUDGE_STAKE);
        vm.stopPrank();
        vm.prank(stranger);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NotOwner.selector, stranger, owner));
        disputes.announceWithdrawal(committee, JUDGES, JUDGE_STAKE);
        vm.prank(owner);
        disputes.announceWithdrawal(committee, JUDGES, JUDGE_STAKE);
        skip(disputes.UNBONDING() + 1);
        disputes.withdrawStake(committee, JUDGES);
        assertEq(coin.balanceOf(owner), JUDGE_STAKE);
    }

    function test_aStakeThatTheTokenRefusesToPayWaits() public {
        announce(0, JUDGE_STAKE);
        skip(disputes.UNBONDING() + 1);
        vm.mockCall(address(coin), abi.encodeCall(coin.transfer, (judges[0], JUDGE_STAKE)), abi.encode(false));
        disputes.withdrawStake(committee, 0);
        vm.clearMockedCalls();
        assertEq(disputes.pendingPayments(judges[0]), JUDGE_STAKE);
        assertStake(committee, 0, 0, 0);
        uint256 before = coin.balanceOf(judges[0]);
        disputes.withdrawPayments(judges[0]);
        assertEq(coin.balanceOf(judges[0]), before + JUDGE_STAKE);
        assertKept();
    }

    function test_aPretendedCommitteeTakesNothingOfOthers() public {
        PretendedCommittee made = new PretendedCommittee(disputes);
        IOracleCommittee pretended = IOracleCommittee(address(made));
        made.setOwner(stranger);
        uint256 before = coin.balanceOf(stranger);
        vm.startPrank(stranger);
        disputes.depositStake(pretended, 0, 2 ether);
        vm.expectPartialRevert(IDisputes.StakeTooLow.selector);
        disputes.announceWithdrawal(pretended, 0, 2 ether + 1);
        disputes.announceWithdrawal(pretended, 0, 2 ether);
        vm.stopPrank();
        skip(disputes.UNBONDING() + 1);
        disputes.withdrawStake(pretended, 0);
        vm.expectPartialRevert(IDisputes.NoWithdrawal.selector);
        disputes.withdrawStake(pretended, 0);
        assertEq(coin.balanceOf(stranger), before);
        assertNothingLost();
    }

    // -- whatever they do -------------------------------------------------------------------------------------

    /// @dev Each step is one byte: a judge that pays, leaves or takes, or a case that is decided.
    function testFuzz_nothingIsKeptOrMade(bytes32 steps) public {
        for (uint256 i = 0; i < 32; ++i) {
            uint8 step = uint8(steps[i]);
            uint8 seat = (step / 4) % JUDGES;
            if (step % 4 == 0) {
                deposit(committee, seat);
            } else if (step % 4 == 1) {
                vm.prank(judges[seat]);
                try disputes.announceWithdrawal(committee, seat, (step / 16) * 1 ether) {} catch {}
            } else if (step % 4 == 2) {
                skip((step / 16) * 2 days);
                try disputes.withdrawStake(committee, seat) {} catch {}
            } else if (i % 4 == 0) {
                Vote memory vote = voteOf(waiting(), Verdict.Accepted);
                try disputes.postVotes(vote, REPORT_URI, signatures(vote, 3)) {} catch {}
                (Ruling[] memory rulings,,) = disputes.caseOf(vote.taskId);
                if (rulings.length != 0) overturn(vote.taskId);
            }
            assertKept();
        }
    }

    // -- helpers ----------------------------------------------------------------------------------------------

    function announce(uint8 seat, uint256 amount) private {
        vm.prank(judges[seat]);
        disputes.announceWithdrawal(committee, seat, amount);
    }

    /// @dev What the first instance said of the task is not what it ends with.
    function overturn(TaskId taskId) private {
        challenge(alice, taskId);
        Vote memory vote = decide(second, secondKeys, 4, taskId, Verdict.Impossible);
        skip(CHALLENGE + 1);
        disputes.close(vote, REPORT_URI);
    }

    function assertStake(OracleCommittee who, uint8 seat, uint256 stake, uint256 leaving) private view {
        (uint256 stakes, uint256 leaves,) = disputes.stakeOf(who, seat);
        assertEq(stakes, stake, "what counts");
        assertEq(leaves, leaving, "what leaves");
    }

    /// @dev No case runs: the contract has the deposits, and nothing else.
    function assertKept() private view {
        assertEq(coin.balanceOf(address(disputes)), deposited());
    }

    function assertNothingLost() private view {
        assertEq(deposited(), 12 * uint256(JUDGE_STAKE));
        assertKept();
    }
}
