// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ICommitteeJudge, Quorum} from "../src/interfaces/ICommitteeJudge.sol";
import {Finding, IJudge} from "../src/interfaces/IJudge.sol";
import {Fault, ITaskManager, Ruling, TaskRequest, TaskState} from "../src/interfaces/ITaskManager.sol";
import {CommitteeJudge} from "../src/judges/CommitteeJudge.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {AUDITOR_ROLE} from "../src/types/Roles.sol";
import {Committee} from "./Committee.sol";
import {Possession} from "./Possession.sol";

contract CommitteeJudgeTest is Committee {
    string private constant REPORT_URI = "https://store/report.json";
    /// @dev Of secp256k1: s and N - s both verify.
    uint256 private constant N = 0xFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFEBAAEDCE6AF48A03BBFD25E8CD0364141;

    // -- votes that count -----------------------------------------------------------------------------------

    function test_anybodyWhoHoldsEnoughVotesPostsTheVerdict() public {
        TaskId taskId = submitted();
        Finding memory vote = accepting(taskId);
        uint256 before = coin.balanceOf(robot1);
        vm.expectEmit(address(committee));
        emit IJudge.Reported(taskId, REPORT_URI, "accepted");
        vm.expectEmit(address(tasks));
        emit ITaskManager.Ruled(taskId, 1, PROOF, Ruling.Accepted, Fault.Nobody, 80 ether, 0, REPORT);
        vm.expectEmit(address(committee));
        emit ICommitteeJudge.VotesCounted(taskId, RULES, 7);
        vm.prank(stranger);
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        assertState(taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), before + 80 ether);
    }

    function test_votesCountInAnyOrderAndMayBeMoreThanNeeded() public {
        TaskId taskId = submitted();
        Finding memory vote = accepting(taskId);
        bytes memory all = sign(judgeKeys[4], vote);
        for (uint256 i = 0; i < 4; ++i) {
            all = abi.encodePacked(all, sign(judgeKeys[3 - i], vote));
        }
        vm.expectEmit(address(committee));
        emit ICommitteeJudge.VotesCounted(taskId, RULES, ALL);
        committee.postVotes(vote, REPORT_URI, all);
    }

    function test_theyMayRejectAndLeaveUndecided() public {
        TaskId taskId = submitted();
        Finding memory vote = accepting(taskId);
        (vote.ruling, vote.amount) = (Ruling.None, 0);
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        assertState(taskId, TaskState.Ruled);
        TaskId another = post(alice, 100 ether);
        submit(another);
        vote = accepting(another);
        (vote.ruling, vote.amount) = (Ruling.Rejected, 0);
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        assertState(another, TaskState.Assigned); // the next attempt
    }

    function test_noSingleKeyJudgesAnyMore() public {
        TaskId taskId = submitted();
        Finding memory f = accepting(taskId);
        vm.expectPartialRevert(ITaskManager.NotJudge.selector);
        vm.prank(oracle);
        oracleJudge.rule(f, "");
    }

    // -- votes that do not ------------------------------------------------------------------------------------

    function test_tooFewVotesAreNoVerdict() public {
        Finding memory vote = accepting(submitted());
        _refused(
            vote,
            signatures(vote, 2),
            abi.encodeWithSelector(ICommitteeJudge.TooFewVotes.selector, vote.taskId, 2, 3)
        );
    }

    function test_aJudgeVotesOnce() public {
        Finding memory vote = accepting(submitted());
        _refused(
            vote,
            abi.encodePacked(signatures(vote, 2), sign(judgeKeys[0], vote)),
            abi.encodeWithSelector(ICommitteeJudge.VotedTwice.selector, vote.taskId, judges[0])
        );
    }

    function test_aStrangersVoteDoesNotCount() public {
        Finding memory vote = accepting(submitted());
        (address other, uint256 key) = makeAddrAndKey("another");
        _refused(vote, abi.encodePacked(signatures(vote, 2), sign(key, vote)), _notAJudge(other));
    }

    function test_aJudgeOfAnotherKindDoesNotJudgeThisOne() public {
        setQuorum(2, 3, 0, 0x0e); // without judge 0
        Finding memory vote = accepting(submitted());
        _refused(vote, signatures(vote, 2), _notAJudge(judges[0]));
    }

    function test_aKindWithoutQuorumIsNotJudged() public {
        vm.expectRevert(abi.encodeWithSelector(ICommitteeJudge.KindWithoutQuorum.selector, CHARGING));
        vm.prank(admin);
        organization.allowKind(CHARGING, committee, RULES);
    }

    /// @dev Votes on something else, with a verdict that TaskManager takes.
    function test_everythingThatTheyVotedOnIsSigned() public {
        Finding memory vote = accepting(submitted());
        for (uint256 part = 0; part < 7; ++part) {
            Finding memory signed = accepting(vote.taskId);
            if (part == 0) signed.attempt = 2;
            if (part == 1) signed.proofHash = "other";
            if (part == 2) signed.reportHash = "other";
            if (part == 3) signed.rulesHash = "other";
            if (part == 4) (signed.ruling, signed.amount) = (Ruling.Rejected, 0);
            if (part == 5) signed.amount = 1;
            if (part == 6) signed.reason = "other";
            bytes memory votes = signatures(signed, 3);
            vm.expectPartialRevert(ICommitteeJudge.NotAJudge.selector);
            committee.postVotes(vote, REPORT_URI, votes);
            assertState(vote.taskId, TaskState.Submitted);
        }
    }

    /// @dev The verdict goes to TaskManager before the votes are counted.
    function test_aVerdictWithoutEnoughVotesPaysNobody() public {
        Finding memory vote = accepting(submitted());
        uint256 before = coin.balanceOf(robot1);
        _refused(
            vote,
            signatures(vote, 2),
            abi.encodeWithSelector(ICommitteeJudge.TooFewVotes.selector, vote.taskId, 2, 3)
        );
        assertState(vote.taskId, TaskState.Submitted);
        assertEq(coin.balanceOf(robot1), before);
        assertEq(tasks.held(), 100 ether);
    }

    function test_aCommitteeDoesNotDecideWhatItHasPassedOn() public {
        TaskId taskId = submitted();
        Finding memory vote = accepting(taskId);
        (vote.ruling, vote.amount) = (Ruling.None, 0);
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        vote = accepting(taskId);
        _refused(vote, signatures(vote, 3), abi.encodeWithSelector(IJudge.PassedOnBefore.selector, taskId, 1));
        vm.prank(auditor);
        auditorJudge.ruleFor(committee, vote, REPORT_URI);
        assertState(taskId, TaskState.Settled);
    }

    function test_aVoteOnOneTaskIsNoneOnAnother() public {
        Finding memory vote = accepting(submitted());
        bytes memory votes = signatures(vote, 3);
        vote.taskId = submitted();
        vm.expectPartialRevert(ICommitteeJudge.NotAJudge.selector);
        committee.postVotes(vote, REPORT_URI, votes);
    }

    function test_aVoteOnAnEarlierAttemptIsNoneOnTheNext() public {
        Finding memory vote = accepting(submitted());
        bytes memory votes = signatures(vote, 3);
        Finding memory rejecting = accepting(vote.taskId);
        (rejecting.ruling, rejecting.amount) = (Ruling.Rejected, 0);
        committee.postVotes(rejecting, REPORT_URI, signatures(rejecting, 3));
        submit(vote.taskId);
        _refused(vote, votes, abi.encodeWithSelector(ITaskManager.WrongAttempt.selector, vote.taskId, 2, 1));
    }

    function test_aVerdictIsPostedOnce() public {
        Finding memory vote = accepting(submitted());
        bytes memory votes = signatures(vote, 3);
        committee.postVotes(vote, REPORT_URI, votes);
        _refused(
            vote,
            votes,
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, vote.taskId, TaskState.Settled, TaskState.Submitted
            )
        );
    }

    function test_aVoteForAnotherChainDoesNotCount() public {
        Finding memory vote = accepting(submitted());
        uint256 here = block.chainid;
        vm.chainId(here + 1);
        bytes memory votes = signatures(vote, 3);
        vm.chainId(here);
        vm.expectPartialRevert(ICommitteeJudge.NotAJudge.selector);
        committee.postVotes(vote, REPORT_URI, votes);
    }

    function test_aVoteForAnotherCommitteeDoesNotCount() public {
        Finding memory vote = accepting(submitted());
        CommitteeJudge ours = committee;
        committee = committeeJudge(address(auditorJudge));
        bytes memory votes = signatures(vote, 3);
        committee = ours;
        vm.expectPartialRevert(ICommitteeJudge.NotAJudge.selector);
        committee.postVotes(vote, REPORT_URI, votes);
    }

    function test_theSecondSignatureThatOneCanComputeFromAFirstDoesNotCount() public {
        Finding memory vote = accepting(submitted());
        (uint8 v, bytes32 r, bytes32 s) = vm.sign(judgeKeys[0], committee.digestOf(vote));
        uint256 high = N - uint256(s);
        assertEq(ecrecover(committee.digestOf(vote), v == 27 ? 28 : 27, r, bytes32(high)), judges[0]);
        // The form has no room for a high s: without its first bit it is of another key, or of none.
        bytes memory two = signatures(vote, 2);
        for (uint256 parity = 0; parity < 2; ++parity) {
            bytes32 vs = bytes32((parity << 255) | (high & (type(uint256).max >> 1)));
            vm.expectPartialRevert(ICommitteeJudge.NotAJudge.selector);
            committee.postVotes(vote, REPORT_URI, abi.encodePacked(two, r, vs));
        }
    }

    function test_signaturesAreWhole() public {
        Finding memory vote = accepting(submitted());
        bytes memory votes = abi.encodePacked(signatures(vote, 3), uint8(0));
        _refused(
            vote, votes, abi.encodeWithSelector(ICommitteeJudge.InvalidSignatures.selector, votes.length)
        );
    }

    // -- parties ------------------------------------------------------------------------------------------

    function test_aPartyDoesNotJudge() public {
        (, uint256 key) = makeAddrAndKey("alice");
        seat(alice, alice);
        setQuorum(3, 5, 0, 0x2f);
        Finding memory vote = accepting(submitted());
        _refused(vote, abi.encodePacked(sign(key, vote), signatures(vote, 2)), _isParty(vote, alice));
    }

    function test_theJudgeOfAPartyDoesNotJudge() public {
        _refusedWithOwner(robot1);
        _refusedWithOwner(alice);
    }

    function test_aJudgeWhoseOwnerOwnsAPartyDoesNotJudge() public {
        address company = makeAddr("company");
        vm.startPrank(admin);
        Possession.register(organization, robot1, "wallet", company, "robot1");
        Possession.register(organization, alice, "wallet", company, "alice");
        vm.stopPrank();
        _refusedWithOwner(company);
    }

    function test_aJudgeThatIsADeviceOfAPartysOwnerDoesNotJudgeWhateverItsSeatSays() public {
        (address company, address sister) = (makeAddr("company"), makeAddr("robot2"));
        vm.startPrank(admin);
        Possession.register(organization, robot1, "wallet", company, "robot1");
        Possession.register(organization, sister, "wallet", company, "robot2");
        vm.stopPrank();
        seat(sister, stranger);
        setQuorum(3, 5, 0, 0x2f);
        Finding memory vote = accepting(submitted());
        (, uint256 key) = makeAddrAndKey("robot2");
        _refused(vote, abi.encodePacked(sign(key, vote), signatures(vote, 2)), _isParty(vote, sister));
    }

    /// @dev One relation at a time: a party's device, a party's owner, another device of its owner.
    function test_noJudgeHasADeviceOrAnOwnerInCommonWithAParty() public {
        address[2] memory parties = [alice, robot1];
        for (uint256 i = 0; i < 2; ++i) {
            for (uint256 relation = 0; relation < 3; ++relation) {
                uint256 before = vm.snapshotState();
                (address party, address company) = (parties[i], makeAddr("company"));
                (address sister, uint256 key) = makeAddrAndKey("robot2");
                (address device, address owner) = relation == 0 ? (sister, party) : (party, company);
                if (relation == 1) owner = sister;
                vm.startPrank(admin);
                Possession.register(organization, device, "wallet", owner, "one");
                if (relation == 2) Possession.register(organization, sister, "wallet", company, "other");
                vm.stopPrank();
                seat(sister, sister);
                setQuorum(3, 5, 0, 0x2f);
                Finding memory vote = accepting(submitted());
                bytes memory votes = abi.encodePacked(sign(key, vote), signatures(vote, 2));
                _refused(vote, votes, _isParty(vote, sister));
                assertTrue(vm.revertToStateAndDelete(before));
            }
        }
    }

    function test_theJudgeOfAnybodyElseDoes() public {
        vm.prank(admin);
        Possession.register(organization, robot1, "wallet", makeAddr("company"), "robot1");
        Finding memory vote = _next();
        bytes memory votes = _withJudgeOf(bob, vote);
        submitted();
        committee.postVotes(vote, REPORT_URI, votes);
        assertState(vote.taskId, TaskState.Settled);
    }

    function test_aNewQuorumCountsForEveryNumberThatTheKindHasHad() public {
        Finding memory vote = accepting(submitted());
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        TaskId old = submitted();
        // Another judge in between: the committee has two numbers of the kind.
        vm.startPrank(admin);
        organization.allowKind(CLEANING, oracleJudge, RULES);
        organization.allowKind(CLEANING, committee, RULES);
        vm.stopPrank();
        TaskId current = submitted();
        setQuorum(3, 4, 0, 0x1e);
        TaskId[2] memory both = [old, current];
        for (uint256 i = 0; i < 2; ++i) {
            vote = accepting(both[i]);
            _refused(
                vote,
                signatures(vote, 3),
                abi.encodeWithSelector(ICommitteeJudge.NotAJudge.selector, judges[0], CLEANING)
            );
            bytes memory votes = signatures(vote, 4);
            committee.postVotes(vote, REPORT_URI, this.without(votes));
            assertState(both[i], TaskState.Settled);
        }
        setQuorum(4, 4, 0, 0x1e);
        vote = accepting(submitted());
        _refused(
            vote,
            this.without(signatures(vote, 4)),
            abi.encodeWithSelector(ICommitteeJudge.TooFewVotes.selector, vote.taskId, 3, 4)
        );
    }

    /// @dev All signatures but the first.
    function without(bytes calldata votes) external pure returns (bytes memory) {
        return votes[64:];
    }

    function test_nobodyDecidesAsAnAuditorWhatItHasPassedOn() public {
        Finding memory vote = accepting(submitted());
        (vote.ruling, vote.amount) = (Ruling.None, 0);
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        // The role comes after the votes, and to a device of the judge's owner, too.
        address sister = makeAddr("device");
        vm.prank(admin);
        Possession.register(organization, sister, "wallet", judges[0], "device");
        address[2] memory own = [judges[0], sister];
        bytes32 role = AUDITOR_ROLE;
        vote = accepting(vote.taskId);
        for (uint256 i = 0; i < 2; ++i) {
            vm.prank(admin);
            organization.grantRole(role, own[i]);
            vm.expectRevert(abi.encodeWithSelector(IJudge.JudgeIsAuditor.selector, vote.taskId, own[i]));
            vm.prank(own[i]);
            auditorJudge.ruleFor(committee, vote, REPORT_URI);
        }
        // One who did not vote decides, and so does the auditor.
        assertFalse(committee.hasPassedOn(vote.taskId, judges[3]));
        vm.prank(auditor);
        auditorJudge.ruleFor(committee, vote, REPORT_URI);
        assertState(vote.taskId, TaskState.Settled);
    }

    function test_attack_aCommitteeDecidesAsTheAuditorsWhatItsJudgePassedOn() public {
        CommitteeJudge above = committeeJudge(address(0));
        for (uint256 i = 2; i < 5; ++i) {
            seatIn(above, judges[i], judgeKeys[i], judges[i]);
        }
        Finding memory vote = accepting(submitted());
        (vote.ruling, vote.amount) = (Ruling.None, 0);
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        vm.startPrank(admin);
        above.setQuorum(CLEANING, 2, 3, 0, 7);
        organization.setAuditors(above);
        organization.removeJudge(organization.numberOf(CLEANING));
        vm.stopPrank();
        vote = accepting(vote.taskId);
        bytes memory last = _signAbove(above, 4, vote);
        bytes memory votes = abi.encodePacked(_signAbove(above, 2, vote), last);
        vm.expectRevert(abi.encodeWithSelector(IJudge.PassedOnBefore.selector, vote.taskId, 1));
        above.postVotes(vote, REPORT_URI, votes);
        // Those who did not pass it on decide.
        above.postVotes(vote, REPORT_URI, abi.encodePacked(_signAbove(above, 3, vote), last));
        assertState(vote.taskId, TaskState.Settled);
    }

    function _signAbove(CommitteeJudge above, uint256 judge, Finding memory vote)
        private
        view
        returns (bytes memory)
    {
        (bytes32 r, bytes32 vs) = vm.signCompact(judgeKeys[judge], above.digestOf(vote));
        return abi.encodePacked(r, vs);
    }

    // -- rotation -------------------------------------------------------------------------------------------

    function test_absentJudgesAreReplacedByTheNextInLine() public {
        setQuorum(2, 2, 10 minutes, ALL);
        vm.warp(5 days * 4000); // the line begins with judge 0
        Finding memory vote = accepting(submitted());
        bytes memory votes = abi.encodePacked(sign(judgeKeys[0], vote), sign(judgeKeys[2], vote));
        skip(10 minutes - 1);
        _refused(vote, votes, _notInPanel(vote, judges[2], 2, 2));
        skip(1);
        committee.postVotes(vote, REPORT_URI, votes); // judge 1 was absent
    }

    function test_withoutRotationThePanelStays() public {
        setQuorum(2, 2, 0, ALL);
        vm.warp(5 days * 4000);
        Finding memory vote = accepting(submitted());
        bytes memory votes = abi.encodePacked(sign(judgeKeys[0], vote), sign(judgeKeys[2], vote));
        skip(WINDOW);
        _refused(vote, votes, _notInPanel(vote, judges[2], 2, 2));
    }

    function test_eachDayAnotherJudgeIsTheFirstInLine() public {
        setQuorum(2, 2, 0, 0x1e); // the four from judge 1 on
        vm.warp(4 days * 5000 + 3 days); // it begins with the last of them
        Finding memory vote = accepting(submitted());
        bytes memory votes = abi.encodePacked(sign(judgeKeys[1], vote), sign(judgeKeys[2], vote));
        _refused(vote, votes, _notInPanel(vote, judges[2], 2, 2));
        committee.postVotes(
            vote, REPORT_URI, abi.encodePacked(sign(judgeKeys[4], vote), sign(judgeKeys[1], vote))
        );
    }

    // -- keys and seats -----------------------------------------------------------------------------------------

    function test_aJudgesKeyChangesInOneCallForEveryKind() public {
        Finding memory vote = accepting(submitted());
        bytes memory old = signatures(vote, 3);
        (address fresh, uint256 key) = makeAddrAndKey("fresh");
        vm.expectEmit(address(committee));
        emit ICommitteeJudge.JudgeKeyChanged(0, judges[0], fresh);
        changeKey(judges[0], judges[0], fresh, key);
        assertEq(committee.keyOf(0), fresh);
        assertEq(committee.seatOf(fresh).owner, judges[0]); // its owner continues to
        assertEq(committee.seatOf(judges[0]).owner, address(0));
        _refused(vote, old, _notAJudge(judges[0]));
        judgeKeys[0] = key;
        _refused(
            vote,
            signatures(vote, 3),
            abi.encodeWithSelector(
                ICommitteeJudge.KeyTooNew.selector, vote.taskId, fresh, block.timestamp - 1
            )
        );
        vote = accepting(submitted());
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
    }

    function test_aKeyHasSignedThatItSits() public {
        (address fresh, uint256 key) = makeAddrAndKey("fresh");
        bytes memory wrong = abi.encodeWithSelector(ICommitteeJudge.KeyNotProven.selector, fresh, bob);
        (bytes32 r, bytes32 vs) = vm.signCompact(key, committee.possessionOf(fresh, alice));
        vm.prank(admin);
        vm.expectRevert(wrong);
        committee.seat(fresh, bob, r, vs);
        (r, vs) = vm.signCompact(judgeKeys[0], committee.possessionOf(fresh, bob));
        vm.prank(admin);
        vm.expectRevert(wrong);
        committee.seat(fresh, bob, r, vs);
        vm.prank(judges[0]);
        vm.expectRevert(abi.encodeWithSelector(ICommitteeJudge.KeyNotProven.selector, fresh, judges[0]));
        committee.changeKey(judges[0], fresh, r, vs);
    }

    function test_aQuorumHasEachOwnerOnce() public {
        (address key, uint256 secret) = makeAddrAndKey("fresh");
        seat(key, secret, judges[0]);
        vm.prank(admin);
        vm.expectRevert(abi.encodeWithSelector(ICommitteeJudge.InvalidQuorum.selector, CLEANING, 3, 5, 6));
        committee.setQuorum(CLEANING, 3, 5, 0, 0x3f);
    }

    function _refuseSeven(address device, address owner) private {
        vm.startPrank(admin);
        committee.setQuorum(CLEANING, 3, 5, 0, 0x7f);
        Possession.register(organization, device, "wallet", owner, "device");
        vm.expectRevert(abi.encodeWithSelector(ICommitteeJudge.InvalidQuorum.selector, CLEANING, 3, 5, 7));
        committee.setQuorum(CLEANING, 3, 5, 0, 0x7f);
        vm.stopPrank();
    }

    function test_attack_anOwnerAndItsDeviceOwnOneSeatEach() public {
        (address one, uint256 first) = makeAddrAndKey("one");
        (address two, uint256 second) = makeAddrAndKey("two");
        seat(one, first, stranger);
        seat(two, second, robot1);
        _refuseSeven(robot1, stranger);
    }

    function test_attack_anOwnersDeviceJudgesForAnotherOne() public {
        (address one, uint256 first) = makeAddrAndKey("one");
        seat(one, first, stranger);
        seat(robot1, bob);
        _refuseSeven(robot1, stranger);
    }

    function test_attack_twoDevicesOfAnOwnerJudgeForOthers() public {
        vm.prank(admin);
        Possession.register(organization, robot2, "wallet", stranger, "another");
        seat(robot1, alice);
        seat(robot2, bob);
        _refuseSeven(robot1, stranger);
    }

    function test_afterAVerdictWhoIsUnseatedDoesNotVote() public {
        _settle(CLEANING);
        setQuorum(2, 3, 0, 0x0e); // without judge 0 and 4
        Finding memory vote = accepting(submitted());
        _refused(
            vote, abi.encodePacked(sign(judgeKeys[0], vote), sign(judgeKeys[1], vote)), _notAJudge(judges[0])
        );
        committee.postVotes(
            vote, REPORT_URI, abi.encodePacked(sign(judgeKeys[1], vote), sign(judgeKeys[2], vote))
        );
        setQuorum(VOTES, JUDGES, 0, ALL);
        _settle(CLEANING);
    }

    function test_theAdministratorTakesAStolenKeyBack() public {
        (address thief, uint256 key) = makeAddrAndKey("thief");
        changeKey(judges[0], judges[0], thief, key);
        (address fresh, uint256 secret) = makeAddrAndKey("fresh");
        changeKey(admin, thief, fresh, secret);
        assertEq(committee.keyOf(0), fresh);
    }

    function test_nobodyElseChangesAKey() public {
        vm.prank(judges[1]);
        vm.expectRevert(abi.encodeWithSelector(IJudge.NotAdministrator.selector, judges[1]));
        committee.changeKey(judges[0], stranger, 0, 0);
    }

    function test_aSeatHasOneKeyAndAKeyOneSeat() public {
        vm.startPrank(admin);
        vm.expectRevert(abi.encodeWithSelector(ICommitteeJudge.AlreadySeated.selector, judges[1]));
        committee.changeKey(judges[0], judges[1], 0, 0);
        vm.expectRevert(abi.encodeWithSelector(ICommitteeJudge.AlreadySeated.selector, judges[1]));
        committee.seat(judges[1], bob, 0, 0);
        vm.expectRevert(abi.encodeWithSelector(ICommitteeJudge.InvalidSeat.selector, stranger, address(0)));
        committee.changeKey(stranger, bob, 0, 0);
        vm.expectRevert(abi.encodeWithSelector(ICommitteeJudge.InvalidSeat.selector, judges[0], judges[0]));
        committee.changeKey(judges[0], address(0), 0, 0);
        vm.expectRevert(abi.encodeWithSelector(ICommitteeJudge.InvalidSeat.selector, address(0), bob));
        committee.seat(address(0), bob, 0, 0);
        vm.expectRevert(abi.encodeWithSelector(ICommitteeJudge.InvalidSeat.selector, bob, address(0)));
        committee.seat(bob, address(0), 0, 0);
        assertEq(committee.keyOf(JUDGES), address(0));
    }

    function test_onlyTheAdministratorSeatsAndSetsAQuorum() public {
        bytes memory refused = abi.encodeWithSelector(IJudge.NotAdministrator.selector, stranger);
        vm.startPrank(stranger);
        vm.expectRevert(refused);
        committee.seat(bob, bob, 0, 0);
        vm.expectRevert(refused);
        committee.setQuorum(CLEANING, 1, 1, 0, 1);
    }

    function test_aQuorumIsMoreThanHalfOfAPanelThatThereIs() public {
        vm.startPrank(admin);
        (uint8[5] memory votes, uint8[5] memory panel, uint64[5] memory who, uint8[5] memory count) = (
            [uint8(0), 2, 4, 3, 2],
            [uint8(1), 4, 3, 5, 3],
            [uint64(31), 31, 31, 15, 0x61], // the last names seat 5 and 6, where nobody sits
            [uint8(5), 5, 5, 4, 3]
        );
        for (uint256 i = 0; i < 5; ++i) {
            vm.expectRevert(
                abi.encodeWithSelector(
                    ICommitteeJudge.InvalidQuorum.selector, CLEANING, votes[i], panel[i], count[i]
                )
            );
            committee.setQuorum(CLEANING, votes[i], panel[i], 0, who[i]);
        }
        committee.setQuorum(CLEANING, 2, 3, 60, 0x15);
        Quorum memory quorum = committee.quorumOf(CLEANING);
        assertEq(abi.encode(quorum), abi.encode(Quorum(2, 3, 60, 3, 0x15)));
    }

    function test_aCommitteeHasSixtyFourSeats() public {
        for (uint8 i = JUDGES; i < 64; ++i) {
            (address key, uint256 secret) = makeAddrAndKey(string.concat("judge", vm.toString(i)));
            seat(key, secret, key);
        }
        vm.startPrank(admin);
        committee.setQuorum(CLEANING, 33, 64, 0, type(uint64).max);
        assertEq(committee.seatOf(makeAddr("judge63")).number, 63);
        vm.expectRevert(abi.encodeWithSelector(ICommitteeJudge.TooManyJudges.selector, 64));
        committee.seat(bob, bob, 0, 0);
    }

    function test_ofSixtyFourJudgesAllVote() public {
        uint256[] memory keys = new uint256[](64);
        for (uint8 i = 0; i < 64; ++i) {
            if (i < JUDGES) {
                keys[i] = judgeKeys[i];
                continue;
            }
            address key;
            (key, keys[i]) = makeAddrAndKey(string.concat("judge", vm.toString(i)));
            seat(key, keys[i], makeAddr(string.concat("owner", vm.toString(i))));
        }
        setQuorum(64, 64, 0, type(uint64).max);
        Finding memory vote = accepting(submitted());
        bytes memory all;
        for (uint256 i = 64; i > 0; --i) {
            all = abi.encodePacked(all, sign(keys[i - 1], vote));
        }
        vm.expectEmit(address(committee));
        emit ICommitteeJudge.VotesCounted(vote.taskId, RULES, type(uint64).max);
        committee.postVotes(vote, REPORT_URI, all);
    }

    // -- help -------------------------------------------------------------------------------------------------

    function _refused(Finding memory vote, bytes memory votes, bytes memory expected) private {
        vm.expectRevert(expected);
        committee.postVotes(vote, REPORT_URI, votes);
    }

    /// @dev A proof of this kind waits for its verdict.
    function _ready(bytes32 kind) private {
        vm.prank(robot1);
        services.registerService(kind, 80 ether, NO_LIMIT, true, "");
        TaskRequest memory wanted = request(100 ether);
        wanted.kind = kind;
        vm.prank(alice);
        submit(tasks.registerTask(wanted));
    }

    /// @dev On the proof that `submitted` will submit.
    function _next() private view returns (Finding memory) {
        TaskId taskId = following(taskNo(tasks.taskCount()));
        return Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 80 ether, "accepted");
    }

    /// @dev The committee has accepted one.
    function _settle(bytes32 kind) private {
        _ready(kind);
        Finding memory vote = accepting(taskNo(tasks.taskCount()));
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
    }

    /// @dev Judge 0 to 2, and one more that works for `owner`.
    function _withJudgeOf(address owner, Finding memory vote) private returns (bytes memory) {
        (address key, uint256 secret) = makeAddrAndKey(string.concat("judge of ", vm.toString(owner)));
        uint8 number = seat(key, secret, owner);
        setQuorum(4, number + 1, 0, uint64((1 << (number + 1)) - 1));
        return abi.encodePacked(signatures(vote, 3), sign(secret, vote));
    }

    function _refusedWithOwner(address owner) private {
        Finding memory vote = _next();
        bytes memory votes = _withJudgeOf(owner, vote);
        submitted();
        _refused(vote, votes, _isParty(vote, owner));
    }

    function _notAJudge(address key) private pure returns (bytes memory) {
        return abi.encodeWithSelector(ICommitteeJudge.NotAJudge.selector, key, CLEANING);
    }

    function _isParty(Finding memory vote, address key) private pure returns (bytes memory) {
        return abi.encodeWithSelector(IJudge.JudgeIsParty.selector, vote.taskId, key);
    }

    function _notInPanel(Finding memory vote, address key, uint256 place, uint256 panel)
        private
        pure
        returns (bytes memory)
    {
        return abi.encodeWithSelector(ICommitteeJudge.NotInPanel.selector, vote.taskId, key, place, panel);
    }
}
