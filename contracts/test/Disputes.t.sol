// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IDisputes, Instance, Ruling} from "../src/interfaces/IDisputes.sol";
import {IOracleCommittee, Vote} from "../src/interfaces/IOracleCommittee.sol";
import {ITaskManager, TaskRequest, TaskState, Verdict} from "../src/interfaces/ITaskManager.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Instances} from "./Instances.sol";

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
        one[0] = Instance(committee, 0, 0, 0);
        setInstances(one);
        Vote memory vote = ruled(Verdict.Accepted);
        assertState(vote.taskId, TaskState.Settled);
    }

    function test_whatIsUndecidedGoesToTheAuditorsAtOnce() public {
        Vote memory vote = ruled(Verdict.Undecided);
        assertState(vote.taskId, TaskState.Undecided);
        assertEmpty(vote.taskId);
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
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.NotTaskManager.selector, stranger));
        committee.countVotes(vote, 0, "");
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
        one[0] = Instance(committee, 0, 0, 0);
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

    // -- instances --------------------------------------------------------------------------------------------

    function test_onlyTheAdministratorSaysWhoJudges() public {
        Instance[] memory wanted = three();
        vm.prank(stranger);
        vm.expectRevert(abi.encodeWithSelector(IDisputes.NotAdministrator.selector, stranger));
        disputes.setInstances(CLEANING, wanted);
    }

    function test_laterInstancesAreOthersAndMore() public {
        for (uint256 part = 0; part < 9; ++part) {
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
        one[0] = Instance(committee, 0, 0, 0);
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
