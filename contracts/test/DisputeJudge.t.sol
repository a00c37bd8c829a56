// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ERC20} from "@openzeppelin/contracts/token/ERC20/ERC20.sol";
import {IDisputeJudge, Instance} from "../src/interfaces/IDisputeJudge.sol";
import {Finding, IJudge} from "../src/interfaces/IJudge.sol";
import {JUDGE_GAS} from "../src/interfaces/IOrganization.sol";
import {Fault, ITaskManager, Ruling, Task, TaskState} from "../src/interfaces/ITaskManager.sol";
import {KindId} from "../src/types/KindId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {AUDITOR_ROLE} from "../src/types/Roles.sol";
import {Instances} from "./Instances.sol";
import {Possession} from "./Possession.sol";

/// @notice Moves the amount, and answers that it did not.
contract Liar is ERC20("Liar", "LIE") {
    function transfer(address to, uint256 amount) public override returns (bool) {
        super.transfer(to, amount);
        return false;
    }
}

/// @notice Burns all gas of whoever calls it.
contract Burner {
    fallback() external {
        while (true) {}
    }
}

/// @notice What can be challenged, who decides then, and who has which stake at the end.
contract DisputeJudgeTest is Instances {
    // -- the course of a case ------------------------------------------------------------------------------

    function test_theFirstRulingStandsForItsWindow() public {
        TaskId taskId = ruled(Ruling.Accepted);
        assertEq(tasks.standing(taskId).until, block.timestamp + CHALLENGE);
        skip(CHALLENGE + 1);
        uint256 before = coin.balanceOf(robot1);
        tasks.conclude(taskId);
        assertEq(coin.balanceOf(robot1) - before, 80 ether);
    }

    function test_aChallengeRulesTheSameAgainUntilTheAnswer() public {
        TaskId taskId = ruled(Ruling.Accepted);
        uint256 until = block.timestamp + DECISION;
        vm.expectEmit(address(tasks));
        emit ITaskManager.Ruled(taskId, 1, PROOF, Ruling.Accepted, Fault.Nobody, 80 ether, until, REPORT);
        challenge(alice, taskId);
        assertEq(tasks.standing(taskId).until, until);
        assertEq(coin.balanceOf(address(disputes)), STAKE);
    }

    function test_theLastInstanceIsFinal() public {
        TaskId taskId = ruled(Ruling.Accepted);
        challenge(alice, taskId);
        decideSecond(taskId, Ruling.Rejected);
        challenge(robot1, taskId);
        uint256 before = coin.balanceOf(robot1);
        decideThird(taskId, Ruling.Accepted);
        assertState(taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1) - before, 80 ether);
        disputes.settle(taskId, 1);
        // Alice was wrong, and robot1 right.
        assertEq(coin.balanceOf(robot1) - before, 80 ether + APPEAL + STAKE);
        assertEq(coin.balanceOf(address(disputes)), 0);
    }

    function test_whoIsRightHasItsStakeBackAndNothingElse() public {
        TaskId taskId = ruled(Ruling.Accepted);
        uint256 before = coin.balanceOf(alice);
        challenge(alice, taskId);
        decideSecond(taskId, Ruling.Void);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        assertEq(coin.balanceOf(alice), before);
        tasks.conclude(taskId);
        assertEq(coin.balanceOf(alice), before + 100 ether);
    }

    function test_whereTheNextInstanceIsSilentTheRulingStandsAndTheStakeGoesBack() public {
        TaskId taskId = ruled(Ruling.Rejected);
        uint256 before = coin.balanceOf(robot1);
        challenge(robot1, taskId);
        skip(DECISION + 1);
        Finding memory f = voteOf(taskId, Ruling.Accepted);
        bytes memory votes = by(second, secondKeys, 4, f);
        vm.expectPartialRevert(IDisputeJudge.WindowOver.selector);
        disputes.postVotes(f, REPORT_URI, votes);
        disputes.settle(taskId, 1);
        assertEq(coin.balanceOf(robot1), before);
        tasks.conclude(taskId);
        assertEq(services.service(serviceNo(1)).rejected, 1);
    }

    function test_aCaseThatWasSettledBeginsNoMore() public {
        TaskId taskId = ruled(Ruling.Rejected);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        Finding memory f = voteOf(taskId, Ruling.Accepted);
        bytes memory votes = signatures(f, 3);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.NotChallenged.selector, taskId));
        disputes.postVotes(f, REPORT_URI, votes);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.NoCase.selector, taskId, 1));
        disputes.settle(taskId, 1);
    }

    function test_settlingWaitsForTheEnd() public {
        TaskId taskId = ruled(Ruling.Rejected);
        skip(CHALLENGE);
        vm.expectPartialRevert(IDisputeJudge.WindowNotOver.selector);
        disputes.settle(taskId, 1);
    }

    function test_aFirstRulingLeavesTimeForAllThatMayFollow() public {
        TaskId taskId = waiting();
        Task memory a = tasks.task(taskId);
        uint256 longest = disputes.longestCase(CLEANING);
        assertEq(longest, 2 * CHALLENGE + 2 * DECISION);
        vm.warp(a.caseEnd - longest + 1);
        Finding memory f = voteOf(taskId, Ruling.Accepted);
        bytes memory votes = signatures(f, 3);
        vm.expectRevert(
            abi.encodeWithSelector(IDisputeJudge.TooLate.selector, taskId, a.caseEnd + 1, a.caseEnd)
        );
        disputes.postVotes(f, REPORT_URI, votes);
        vm.warp(a.caseEnd - longest);
        disputes.postVotes(f, REPORT_URI, votes);
        skip(CHALLENGE);
        challenge(alice, taskId);
        skip(DECISION);
        decideSecond(taskId, Ruling.Rejected);
        skip(CHALLENGE);
        challenge(robot1, taskId);
        assertEq(tasks.standing(taskId).until, a.caseEnd);
    }

    function test_whatTheFirstInstanceCannotDecideGoesToTheAuditorsAndLaterOnesMust() public {
        TaskId taskId = ruled(Ruling.None);
        Finding memory f = voteOf(taskId, Ruling.Accepted);
        bytes memory votes = signatures(f, 3);
        vm.expectRevert(abi.encodeWithSelector(IJudge.PassedOnBefore.selector, taskId, 1));
        disputes.postVotes(f, REPORT_URI, votes);
        _grantAuditor(judges[1]);
        vm.expectRevert(abi.encodeWithSelector(IJudge.JudgeIsAuditor.selector, taskId, judges[1]));
        vm.prank(judges[1]);
        auditorJudge.ruleFor(disputes, f, REPORT_URI);
        assertFalse(disputes.hasPassedOn(taskId, judges[4]));
        vm.prank(auditor);
        auditorJudge.ruleFor(disputes, f, REPORT_URI);
        assertState(taskId, TaskState.Settled);

        taskId = ruled(Ruling.Accepted);
        challenge(alice, taskId);
        f = voteOf(taskId, Ruling.None);
        votes = by(second, secondKeys, 4, f);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.MustDecide.selector, taskId));
        disputes.postVotes(f, REPORT_URI, votes);
    }

    function test_aRemovedJudgesCasesAreVoidAndAllStakesGoBack() public {
        setInstances(threeWithStakes());
        for (uint8 i = 0; i < 3; ++i) {
            deposit(committee, i, 8 ether);
        }
        TaskId taskId = ruled(Ruling.Accepted);
        uint256 before = coin.balanceOf(alice);
        challenge(alice, taskId);
        KindId number = organization.numberOf(CLEANING);
        vm.prank(admin);
        organization.removeJudge(number);
        disputes.settle(taskId, 1);
        assertEq(coin.balanceOf(alice), before);
        (uint256 stake, uint256 open,,) = disputes.stakeOf(committee, 0);
        assertEq(stake, 8 ether);
        assertEq(open, 0);
        tasks.conclude(taskId);
        vm.warp(tasks.standing(taskId).until + 1);
        tasks.conclude(taskId);
        assertState(taskId, TaskState.Failed);
    }

    /// @dev What pays alice's stake back misbehaves: where nobody answers, the case is settled.
    function _payBackBy(address token) private returns (uint256 before, uint256 gas) {
        TaskId taskId = ruled(Ruling.Accepted);
        before = coin.balanceOf(alice);
        challenge(alice, taskId);
        vm.mockFunction(address(coin), token, abi.encodeCall(coin.transfer, (alice, uint256(STAKE))));
        skip(DECISION + 1);
        gas = gasleft();
        disputes.settle(taskId, 1);
        gas -= gasleft();
    }

    function test_attack_aTokenThatPaysAndSaysNoPaysOthersStakesTwice() public {
        (uint256 before,) = _payBackBy(address(new Liar()));
        assertEq(coin.balanceOf(alice) + disputes.pendingPayments(alice), before);
        assertEq(coin.balanceOf(address(disputes)), disputes.pendingPayments(alice));
    }

    function test_aRecipientThatBurnsAllGasHoldsUpNoCase() public {
        (, uint256 gas) = _payBackBy(address(new Burner()));
        assertEq(disputes.pendingPayments(alice), STAKE);
        assertLt(gas, 500_000);
        vm.clearMockedCalls();
    }

    function test_attack_aStrangerPaysItselfFromTheStakes() public {
        challenge(alice, ruled(Ruling.Accepted));
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.NotItself.selector, stranger));
        vm.prank(stranger);
        disputes.payOrRevert(stranger, STAKE);
    }

    // -- who challenges ------------------------------------------------------------------------------------

    function test_partiesTheirOwnersAndJudgesChallengeAndNobodyElse() public {
        TaskId taskId = ruled(Ruling.Accepted);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.NeitherPartyNorJudge.selector, taskId, stranger));
        challenge(stranger, taskId);
        vm.prank(admin);
        Possession.register(organization, robot1, "wallet", stranger, "robot1");
        challenge(stranger, taskId);
    }

    function test_aChallengeComesInTheWindow() public {
        TaskId taskId = ruled(Ruling.Accepted);
        skip(CHALLENGE + 1);
        vm.expectPartialRevert(IDisputeJudge.WindowOver.selector);
        challenge(alice, taskId);
    }

    function test_aPartyTakesOverWhatAJudgeHasChallenged() public {
        TaskId taskId = ruled(Ruling.Accepted);
        uint256 before = coin.balanceOf(judges[0]);
        challenge(judges[0], taskId);
        uint256 until = tasks.standing(taskId).until;
        skip(1 minutes);
        challenge(alice, taskId);
        assertEq(coin.balanceOf(judges[0]), before);
        assertEq(coin.balanceOf(address(disputes)), STAKE);
        assertEq(tasks.standing(taskId).until, until);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.ChallengedBefore.selector, taskId, alice));
        challenge(robot1, taskId);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.ChallengedBefore.selector, taskId, alice));
        challenge(judges[0], taskId);
    }

    function test_nobodyTakesOverAfterTheWindow() public {
        TaskId taskId = ruled(Ruling.Accepted);
        challenge(judges[0], taskId);
        skip(CHALLENGE + 1);
        vm.expectPartialRevert(IDisputeJudge.WindowOver.selector);
        challenge(alice, taskId);
    }

    function test_anEndThatIsWorseProvesAPartyWrong() public {
        TaskId taskId = ruled(Ruling.GivenUp);
        uint256 before = coin.balanceOf(robot1);
        challenge(robot1, taskId);
        decideSecond(taskId, Ruling.Rejected);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        assertEq(before - coin.balanceOf(robot1), STAKE);
    }

    /// @dev Giving up costs a newcomer the penalty, and a void costs it nothing.
    function test_aVoidIsBetterForTheExecutorThanToHaveGivenUp() public {
        uint256 snapshot = vm.snapshotState();
        TaskId taskId = ruled(Ruling.GivenUp);
        uint256 before = coin.balanceOf(robot1);
        challenge(robot1, taskId);
        decideSecond(taskId, Ruling.Void);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        assertEq(coin.balanceOf(robot1), before);
        vm.revertToState(snapshot);
        taskId = ruled(Ruling.GivenUp);
        before = coin.balanceOf(alice);
        challenge(alice, taskId);
        decideSecond(taskId, Ruling.Void);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        assertEq(before - coin.balanceOf(alice), STAKE);
    }

    function test_anEndThatPaysLessProvesTheCreatorRight() public {
        TaskId taskId = ruled(Ruling.Accepted);
        uint256 before = coin.balanceOf(alice);
        challenge(alice, taskId);
        Finding memory f = voteOf(taskId, Ruling.Accepted);
        f.amount = 40 ether;
        disputes.postVotes(f, REPORT_URI, by(second, secondKeys, 4, f));
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        assertEq(coin.balanceOf(alice), before);
    }

    function test_theStakeOfAWrongJudgeGoesToTheParty() public {
        TaskId taskId = ruled(Ruling.Accepted);
        challenge(judges[0], taskId);
        uint256 before = coin.balanceOf(robot1);
        decideSecond(taskId, Ruling.Accepted);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        assertEq(coin.balanceOf(robot1) - before, STAKE);
    }

    function test_halfOfItGoesToTheTreasuryIfThePartyOwnsAJudge() public {
        seat(robot1, robot1);
        setQuorum(VOTES, JUDGES, 0, 0x3f);
        TaskId taskId = ruledByAny();
        challenge(alice, taskId);
        (uint256 ours, uint256 treasury) = (coin.balanceOf(robot1), coin.balanceOf(address(organization)));
        decideSecond(taskId, Ruling.Accepted);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        assertEq(coin.balanceOf(robot1) - ours, STAKE / 2);
        assertEq(coin.balanceOf(address(organization)) - treasury, STAKE / 2);
    }

    /// @dev Whoever is in the panel today: judge 0 to 2, if the line begins with one that lets them in.
    function ruledByAny() internal returns (TaskId taskId) {
        setQuorum(VOTES, JUDGES, 1, 0x3f);
        taskId = waiting();
        skip(10);
        first(taskId, Ruling.Accepted);
    }

    // -- stakes of judges ----------------------------------------------------------------------------------

    function test_openAcceptedAmountsAreAtMostTenTimesTheStake() public {
        setInstances(threeWithStakes());
        for (uint8 i = 0; i < 3; ++i) {
            deposit(committee, i, 10 ether);
        }
        TaskId taskId = ruled(Ruling.Accepted);
        (, uint256 open,,) = disputes.stakeOf(committee, 0);
        assertEq(open, 80 ether);
        TaskId another = waiting();
        Finding memory f = voteOf(another, Ruling.Accepted);
        bytes memory votes = signatures(f, 3);
        vm.expectRevert(
            abi.encodeWithSelector(
                IDisputeJudge.StakeTooLow.selector, committee, uint8(0), 10 ether, 16 ether
            )
        );
        disputes.postVotes(f, REPORT_URI, votes);
        // A rejection locks nothing.
        uint256 snapshot = vm.snapshotState();
        first(another, Ruling.Rejected);
        vm.revertToState(snapshot);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        (, open,,) = disputes.stakeOf(committee, 0);
        assertEq(open, 0);
        disputes.postVotes(f, REPORT_URI, votes);
    }

    function test_whatStandsForOpenRulingsDoesNotLeave() public {
        setInstances(threeWithStakes());
        for (uint8 i = 0; i < 3; ++i) {
            deposit(committee, i, 10 ether);
        }
        ruled(Ruling.Accepted);
        vm.startPrank(judges[0]);
        vm.expectRevert(
            abi.encodeWithSelector(
                IDisputeJudge.StakeTooLow.selector, committee, uint8(0), 10 ether, 11 ether
            )
        );
        disputes.announceWithdrawal(committee, 0, 3 ether);
        disputes.announceWithdrawal(committee, 0, 2 ether);
        vm.stopPrank();
    }

    function test_whoAcceptedWhatIsOverturnedLosesItsStake() public {
        setInstances(threeWithStakes());
        _fund();
        uint256 treasury = coin.balanceOf(address(organization));
        TaskId taskId = ruled(Ruling.Accepted);
        challenge(alice, taskId);
        decideSecond(taskId, Ruling.Rejected);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        (uint256 stake, uint256 open,,) = disputes.stakeOf(committee, 0);
        assertEq(stake, 8 ether - JUDGE_STAKE);
        assertEq(open, 0);
        assertEq(coin.balanceOf(address(organization)) - treasury, 3 * JUDGE_STAKE);
    }

    function test_whoRejectedWhatIsOverturnedLosesOnlyWhatIsFree() public {
        setInstances(threeWithStakes());
        _fund();
        TaskId accepted = ruled(Ruling.Accepted);
        TaskId taskId = ruled(Ruling.Rejected);
        challenge(robot1, taskId);
        decideSecond(taskId, Ruling.Void);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        // All eight stand for the one that it has accepted.
        (uint256 stake, uint256 open,,) = disputes.stakeOf(committee, 0);
        assertEq(stake, 8 ether);
        assertEq(open, 80 ether);
        disputes.settle(accepted, 1);
    }

    /// @dev A tenth of the price is paid, and stands for as much.
    function test_attack_oneStakeForAnyNumberOfImpossibleTasks() public {
        Instance[] memory all = threeWithStakes();
        all[0].judgeStake = 1 ether;
        setInstances(all);
        for (uint8 i = 0; i < 3; ++i) {
            deposit(committee, i, 1 ether);
        }
        TaskId taskId = ruled(Ruling.Impossible);
        (, uint256 open,,) = disputes.stakeOf(committee, 0);
        assertEq(open, 8 ether);
        TaskId another = waiting();
        Finding memory f = voteOf(another, Ruling.Impossible);
        bytes memory votes = signatures(f, 3);
        vm.expectRevert(
            abi.encodeWithSelector(
                IDisputeJudge.StakeTooLow.selector, committee, uint8(0), 1 ether, 1.6 ether
            )
        );
        disputes.postVotes(f, REPORT_URI, votes);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        (, open,,) = disputes.stakeOf(committee, 0);
        assertEq(open, 0);
        disputes.postVotes(f, REPORT_URI, votes);
    }

    function test_whoSaysImpossibleWhatIsOverturnedLosesWhatWasLocked() public {
        setInstances(threeWithStakes());
        for (uint8 i = 0; i < 4; ++i) {
            if (i < 3) deposit(committee, i, JUDGE_STAKE);
            deposit(second, i, 8 ether);
        }
        uint256 treasury = coin.balanceOf(address(organization));
        TaskId taskId = ruled(Ruling.Impossible);
        challenge(alice, taskId);
        decideSecond(taskId, Ruling.Rejected);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        (uint256 stake, uint256 open,,) = disputes.stakeOf(committee, 0);
        assertEq(stake + open, 0);
        assertEq(coin.balanceOf(address(organization)) - treasury, 3 * JUDGE_STAKE);
    }

    function test_aStakeThatDoesNotArriveIsRefused() public {
        vm.mockCall(address(coin), abi.encodeWithSelector(coin.transferFrom.selector), abi.encode(true));
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.WrongStakeReceived.selector, JUDGE_STAKE, 0));
        vm.prank(stranger);
        disputes.depositStake(committee, 0, JUDGE_STAKE);
    }

    function test_aStakeLeavesAfterTheLongestCase() public {
        deposit(committee, 0, 10 ether);
        vm.prank(judges[0]);
        disputes.announceWithdrawal(committee, 0, 4 ether);
        vm.expectPartialRevert(IDisputeJudge.WithdrawalTooEarly.selector);
        disputes.withdrawStake(committee, 0);
        skip(30 days + 1);
        uint256 before = coin.balanceOf(judges[0]);
        disputes.withdrawStake(committee, 0);
        assertEq(coin.balanceOf(judges[0]) - before, 4 ether);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.NotOwner.selector, stranger, judges[0]));
        vm.prank(stranger);
        disputes.announceWithdrawal(committee, 0, 1);
    }

    // -- instances -----------------------------------------------------------------------------------------

    function test_anInstanceWithoutAQuorumOrWithAWindowOfASecondIsRefused() public {
        Instance[] memory all = three();
        all[0].window = 1;
        _refuse(all, abi.encodeWithSelector(IDisputeJudge.InvalidInstances.selector, CLEANING, 0));
        all = three();
        all[1].decision = 59;
        _refuse(all, abi.encodeWithSelector(IDisputeJudge.InvalidInstances.selector, CLEANING, 1));
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.InvalidInstances.selector, CHARGING, 0));
        vm.prank(admin);
        disputes.setInstances(CHARGING, three());
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.KindWithoutInstances.selector, CHARGING));
        vm.prank(admin);
        organization.allowKind(CHARGING, disputes, RULES);
    }

    function _grantAuditor(address account) private {
        bytes32 role = AUDITOR_ROLE;
        vm.prank(admin);
        organization.grantRole(role, account);
    }

    /// @dev A quorum that changes, or an owner, after the instances were set.
    function test_nobodyDecidesAChallengeOfWhatItSaidWhateverChangedMeanwhile() public {
        (address cousin, uint256 secret) = makeAddrAndKey("cousin");
        seatIn(second, cousin, secret, judges[0]);
        vm.prank(admin);
        second.setQuorum(CLEANING, 5, 8, 0, 0xff);
        TaskId taskId = ruled(Ruling.Accepted);
        challenge(alice, taskId);
        Finding memory f = voteOf(taskId, Ruling.Rejected);
        bytes memory four = by(second, secondKeys, 4, f);
        (bytes32 r, bytes32 vs) = vm.signCompact(secret, second.digestOf(f));
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.JudgesTwice.selector, CLEANING, cousin));
        disputes.postVotes(f, REPORT_URI, abi.encodePacked(four, r, vs));
        disputes.postVotes(f, REPORT_URI, by(second, secondKeys, 5, f));
        instance = 1;
        challenge(robot1, taskId);
        decideThird(taskId, Ruling.Accepted);
        assertState(taskId, TaskState.Settled);
    }

    function test_termsOfThreeInstancesFitIntoWhatAJudgeMaySpend() public {
        uint256 before = gasleft();
        disputes.termsFor(CLEANING);
        assertLt(before - gasleft(), JUDGE_GAS / 2);
    }

    function test_nobodySitsInTwoInstancesByKeyOrOwner() public {
        (address key, uint256 secret) = makeAddrAndKey("cousin");
        seatIn(second, key, secret, judges[0]);
        vm.prank(admin);
        second.setQuorum(CLEANING, 5, 8, 0, 0xff);
        Instance[] memory all = new Instance[](2);
        (all[0], all[1]) = (three()[0], three()[2]);
        all[1].committee = second;
        _refuse(all, abi.encodeWithSelector(IDisputeJudge.JudgesTwice.selector, CLEANING, key));
    }

    function test_laterInstancesMakeNoCaseLongerThanWhatTheKindAgreedTo() public {
        Instance[] memory all = three();
        all[0].window += 1;
        _refuse(
            all,
            abi.encodeWithSelector(
                IDisputeJudge.CaseTooLong.selector, CLEANING, 1 hours + 1, 1 hours + 1 minutes
            )
        );
    }

    /// @dev Tasks that were posted under it keep their windows, in which a longer case would always be void.
    function test_anEarlierNumberKeepsItsCasesShortUntilItIsRemoved() public {
        KindId number = cleaning();
        vm.prank(admin);
        organization.allowKind(CLEANING, oracleJudge, RULES);
        Instance[] memory all = three();
        all[0].window += 1;
        _refuse(
            all,
            abi.encodeWithSelector(
                IDisputeJudge.CaseTooLong.selector, CLEANING, 1 hours + 1, 1 hours + 1 minutes
            )
        );
        setInstances(three());
        vm.prank(admin);
        organization.removeJudge(number);
        setInstances(all);
        assertEq(disputes.longestCase(CLEANING), 1 hours + 1);
    }

    function _fund() private {
        for (uint8 i = 0; i < 4; ++i) {
            if (i < 3) deposit(committee, i, 8 ether);
            deposit(second, i, 8 ether);
        }
    }

    function _refuse(Instance[] memory all, bytes memory wrong) private {
        vm.expectRevert(wrong);
        vm.prank(admin);
        disputes.setInstances(CLEANING, all);
    }
}
