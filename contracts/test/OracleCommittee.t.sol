// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {OracleCommittee} from "../src/OracleCommittee.sol";
import {IOracleCommittee, Judge, Quorum, Vote} from "../src/interfaces/IOracleCommittee.sol";
import {Review} from "../src/interfaces/IOrganization.sol";
import {ITaskManager, Silence, TaskRequest, TaskState, Verdict} from "../src/interfaces/ITaskManager.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Committee} from "./Committee.sol";
import {Possession} from "./Possession.sol";

contract OracleCommitteeTest is Committee {
    string private constant REPORT_URI = "https://store/report.json";
    /// @dev Of secp256k1: s and N - s both verify.
    uint256 private constant N = 0xFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFEBAAEDCE6AF48A03BBFD25E8CD0364141;

    // -- votes that count -----------------------------------------------------------------------------------

    function test_anybodyWhoHoldsEnoughVotesPostsTheVerdict() public {
        TaskId taskId = submitted();
        Vote memory vote = accepting(taskId);
        uint256 before = coin.balanceOf(robot1);
        vm.expectEmit(address(tasks));
        emit ITaskManager.VerdictPosted(
            taskId, 1, PROOF, Verdict.Accepted, 80 ether, REPORT, REPORT_URI, "accepted"
        );
        vm.expectEmit(address(committee));
        emit IOracleCommittee.VotesCounted(taskId, 1, RULES, 7);
        vm.prank(stranger);
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        assertState(taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), before + 80 ether);
    }

    function test_votesCountInAnyOrderAndMayBeMoreThanNeeded() public {
        TaskId taskId = submitted();
        Vote memory vote = accepting(taskId);
        bytes memory all = sign(judgeKeys[4], vote);
        for (uint256 i = 0; i < 4; ++i) {
            all = abi.encodePacked(all, sign(judgeKeys[3 - i], vote));
        }
        vm.expectEmit(address(committee));
        emit IOracleCommittee.VotesCounted(taskId, 1, RULES, ALL);
        committee.postVotes(vote, REPORT_URI, all);
    }

    function test_theyMayRejectAndLeaveUndecided() public {
        TaskId taskId = submitted();
        Vote memory vote = accepting(taskId);
        (vote.verdict, vote.amount) = (Verdict.Undecided, 0);
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        assertState(taskId, TaskState.Undecided);
        TaskId another = post(alice, 100 ether);
        submit(another);
        vote = accepting(another);
        (vote.verdict, vote.amount) = (Verdict.Rejected, 0);
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        assertState(another, TaskState.Assigned); // the next attempt
    }

    function test_noSingleKeyJudgesAnyMore() public {
        TaskId taskId = submitted();
        vm.prank(judges[0]);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotJudge.selector, judges[0], CLEANING));
        tasks.postVerdict(taskId, 1, PROOF, Verdict.Accepted, 80 ether, REPORT, "", "");
    }

    // -- votes that do not ------------------------------------------------------------------------------------

    function test_tooFewVotesAreNoVerdict() public {
        Vote memory vote = accepting(submitted());
        _refused(
            vote,
            signatures(vote, 2),
            abi.encodeWithSelector(IOracleCommittee.TooFewVotes.selector, vote.taskId, 2, 3)
        );
    }

    function test_aJudgeVotesOnce() public {
        Vote memory vote = accepting(submitted());
        _refused(
            vote,
            abi.encodePacked(signatures(vote, 2), sign(judgeKeys[0], vote)),
            abi.encodeWithSelector(IOracleCommittee.VotedTwice.selector, vote.taskId, judges[0])
        );
    }

    function test_aStrangersVoteDoesNotCount() public {
        Vote memory vote = accepting(submitted());
        (address other, uint256 key) = makeAddrAndKey("another");
        _refused(vote, abi.encodePacked(signatures(vote, 2), sign(key, vote)), _notAJudge(other));
    }

    function test_aJudgeOfAnotherKindDoesNotJudgeThisOne() public {
        setQuorum(2, 3, 0, 0x0e); // without judge 0
        Vote memory vote = accepting(submitted());
        _refused(vote, signatures(vote, 2), _notAJudge(judges[0]));
    }

    function test_aKindWithoutQuorumIsNotJudged() public {
        vm.prank(robot1);
        services.registerService(CHARGING, 1 ether, NO_LIMIT, true, "");
        vm.prank(alice);
        TaskId taskId = tasks.registerTask(
            TaskRequest(CHARGING, 2 ether, WINDOW, WINDOW, ATTEMPTS, 0, 0, address(0), "{}")
        );
        submit(taskId);
        Vote memory vote = accepting(taskId);
        _refused(
            vote,
            signatures(vote, 3),
            abi.encodeWithSelector(IOracleCommittee.KindWithoutQuorum.selector, CHARGING)
        );
    }

    /// @dev Votes on something else, with a verdict that TaskManager takes.
    function test_everythingThatTheyVotedOnIsSigned() public {
        Vote memory vote = accepting(submitted());
        for (uint256 part = 0; part < 7; ++part) {
            Vote memory signed = accepting(vote.taskId);
            if (part == 0) signed.attempt = 2;
            if (part == 1) signed.proofHash = "other";
            if (part == 2) signed.reportHash = "other";
            if (part == 3) signed.rulesHash = "other";
            if (part == 4) (signed.verdict, signed.amount) = (Verdict.Rejected, 0);
            if (part == 5) signed.amount = 1;
            if (part == 6) signed.reason = "other";
            bytes memory votes = signatures(signed, 3);
            vm.expectPartialRevert(IOracleCommittee.NotAJudge.selector);
            committee.postVotes(vote, REPORT_URI, votes);
            assertState(vote.taskId, TaskState.Submitted);
        }
    }

    /// @dev The verdict goes to TaskManager before the votes are counted.
    function test_aVerdictWithoutEnoughVotesPaysNobody() public {
        Vote memory vote = accepting(submitted());
        uint256 before = coin.balanceOf(robot1);
        _refused(
            vote,
            signatures(vote, 2),
            abi.encodeWithSelector(IOracleCommittee.TooFewVotes.selector, vote.taskId, 2, 3)
        );
        assertState(vote.taskId, TaskState.Submitted);
        assertEq(coin.balanceOf(robot1), before);
        assertEq(tasks.held(), 100 ether);
    }

    /// @dev Not even one whose judges are the organization's auditors: these decide as persons.
    function test_aCommitteeDoesNotDecideWhatWasLeftUndecided() public {
        TaskId taskId = submitted();
        Vote memory vote = accepting(taskId);
        (vote.verdict, vote.amount) = (Verdict.Undecided, 0);
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        OracleCommittee another = new OracleCommittee(organization);
        bytes32 role = organization.AUDITOR_ROLE();
        vm.startPrank(admin);
        organization.grantRole(role, address(another));
        another.seat(judges[0], judges[0]);
        another.setQuorum(CLEANING, 1, 1, 0, 1);
        vm.stopPrank();
        (vote.verdict, vote.amount) = (Verdict.Accepted, 80 ether);
        (bytes32 r, bytes32 vs) = vm.signCompact(judgeKeys[0], another.digestOf(vote));
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, taskId, TaskState.Undecided, TaskState.Submitted
            )
        );
        another.postVotes(vote, REPORT_URI, abi.encodePacked(r, vs));
    }

    function test_aVoteOnOneTaskIsNoneOnAnother() public {
        Vote memory vote = accepting(submitted());
        bytes memory votes = signatures(vote, 3);
        vote.taskId = submitted();
        vm.expectPartialRevert(IOracleCommittee.NotAJudge.selector);
        committee.postVotes(vote, REPORT_URI, votes);
    }

    function test_aVoteOnAnEarlierAttemptIsNoneOnTheNext() public {
        Vote memory vote = accepting(submitted());
        bytes memory votes = signatures(vote, 3);
        Vote memory rejecting = accepting(vote.taskId);
        (rejecting.verdict, rejecting.amount) = (Verdict.Rejected, 0);
        committee.postVotes(rejecting, REPORT_URI, signatures(rejecting, 3));
        submit(vote.taskId);
        _refused(vote, votes, abi.encodeWithSelector(ITaskManager.WrongAttempt.selector, vote.taskId, 2, 1));
    }

    function test_aVerdictIsPostedOnce() public {
        Vote memory vote = accepting(submitted());
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
        Vote memory vote = accepting(submitted());
        uint256 here = block.chainid;
        vm.chainId(here + 1);
        bytes memory votes = signatures(vote, 3);
        vm.chainId(here);
        vm.expectPartialRevert(IOracleCommittee.NotAJudge.selector);
        committee.postVotes(vote, REPORT_URI, votes);
    }

    function test_aVoteForAnotherCommitteeDoesNotCount() public {
        Vote memory vote = accepting(submitted());
        OracleCommittee ours = committee;
        committee = new OracleCommittee(organization);
        bytes memory votes = signatures(vote, 3);
        committee = ours;
        vm.expectPartialRevert(IOracleCommittee.NotAJudge.selector);
        committee.postVotes(vote, REPORT_URI, votes);
    }

    function test_theSecondSignatureThatOneCanComputeFromAFirstDoesNotCount() public {
        Vote memory vote = accepting(submitted());
        (uint8 v, bytes32 r, bytes32 s) = vm.sign(judgeKeys[0], committee.digestOf(vote));
        uint256 high = N - uint256(s);
        assertEq(ecrecover(committee.digestOf(vote), v == 27 ? 28 : 27, r, bytes32(high)), judges[0]);
        // The form has no room for a high s: without its first bit it is of another key, or of none.
        bytes memory two = signatures(vote, 2);
        for (uint256 parity = 0; parity < 2; ++parity) {
            bytes32 vs = bytes32((parity << 255) | (high & (type(uint256).max >> 1)));
            vm.expectPartialRevert(IOracleCommittee.NotAJudge.selector);
            committee.postVotes(vote, REPORT_URI, abi.encodePacked(two, r, vs));
        }
    }

    function test_signaturesAreWhole() public {
        Vote memory vote = accepting(submitted());
        bytes memory votes = abi.encodePacked(signatures(vote, 3), uint8(0));
        _refused(
            vote, votes, abi.encodeWithSelector(IOracleCommittee.InvalidSignatures.selector, votes.length)
        );
    }

    // -- parties ------------------------------------------------------------------------------------------

    function test_aPartyDoesNotJudge() public {
        (, uint256 key) = makeAddrAndKey("alice");
        vm.prank(admin);
        committee.seat(alice, alice);
        setQuorum(3, 5, 0, 0x3f);
        Vote memory vote = accepting(submitted());
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
        committee.seat(sister, stranger);
        vm.stopPrank();
        setQuorum(3, 5, 0, 0x3f);
        Vote memory vote = accepting(submitted());
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
                committee.seat(sister, sister);
                vm.stopPrank();
                setQuorum(3, 5, 0, 0x3f);
                Vote memory vote = accepting(submitted());
                bytes memory votes = abi.encodePacked(sign(key, vote), signatures(vote, 2));
                _refused(vote, votes, _isParty(vote, sister));
                assertTrue(vm.revertToStateAndDelete(before));
            }
        }
    }

    function test_theJudgeOfAnybodyElseDoes() public {
        vm.prank(admin);
        Possession.register(organization, robot1, "wallet", makeAddr("company"), "robot1");
        Vote memory vote = accepting(submitted());
        committee.postVotes(vote, REPORT_URI, _withJudgeOf(bob, vote));
        assertState(vote.taskId, TaskState.Settled);
    }

    function test_anAuditorDoesNotLeaveToItselfWhatItSaysIsUndecided() public {
        bytes32 role = organization.AUDITOR_ROLE();
        vm.prank(admin);
        organization.grantRole(role, judges[0]);
        Vote memory vote = accepting(submitted());
        (vote.verdict, vote.amount) = (Verdict.Undecided, 0);
        _refused(
            vote,
            signatures(vote, 3),
            abi.encodeWithSelector(IOracleCommittee.JudgeIsAuditor.selector, vote.taskId, judges[0])
        );
        vote = accepting(vote.taskId);
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
        assertState(vote.taskId, TaskState.Settled);
    }

    // -- rotation -------------------------------------------------------------------------------------------

    function test_absentJudgesAreReplacedByTheNextInLine() public {
        setQuorum(2, 2, 10 minutes, ALL);
        vm.warp(5 days * 1000); // the line begins with judge 0
        Vote memory vote = accepting(submitted());
        bytes memory votes = abi.encodePacked(sign(judgeKeys[0], vote), sign(judgeKeys[2], vote));
        skip(10 minutes - 1);
        _refused(vote, votes, _notInPanel(vote, judges[2], 2, 2));
        skip(1);
        committee.postVotes(vote, REPORT_URI, votes); // judge 1 was absent
    }

    function test_withoutRotationThePanelStays() public {
        setQuorum(2, 2, 0, ALL);
        vm.warp(5 days * 1000);
        Vote memory vote = accepting(submitted());
        bytes memory votes = abi.encodePacked(sign(judgeKeys[0], vote), sign(judgeKeys[2], vote));
        skip(WINDOW);
        _refused(vote, votes, _notInPanel(vote, judges[2], 2, 2));
    }

    function test_eachDayAnotherJudgeIsTheFirstInLine() public {
        setQuorum(2, 2, 0, 0x1e); // the four from judge 1 on
        vm.warp(4 days * 1000 + 3 days); // it begins with the last of them
        Vote memory vote = accepting(submitted());
        bytes memory votes = abi.encodePacked(sign(judgeKeys[1], vote), sign(judgeKeys[2], vote));
        _refused(vote, votes, _notInPanel(vote, judges[2], 2, 2));
        committee.postVotes(
            vote, REPORT_URI, abi.encodePacked(sign(judgeKeys[4], vote), sign(judgeKeys[1], vote))
        );
    }

    // -- keys and seats -----------------------------------------------------------------------------------------

    function test_aJudgesKeyChangesInOneCallForEveryKind() public {
        vm.prank(admin);
        committee.setQuorum(CHARGING, VOTES, JUDGES, 0, ALL);
        Vote memory vote = accepting(submitted());
        bytes memory old = signatures(vote, 3);
        (address fresh, uint256 key) = makeAddrAndKey("fresh");
        vm.expectEmit(address(committee));
        emit IOracleCommittee.JudgeKeyChanged(0, judges[0], fresh);
        vm.prank(judges[0]);
        committee.changeKey(judges[0], fresh);
        assertEq(committee.keyOf(0), fresh);
        assertEq(committee.judge(fresh).owner, judges[0]); // who owned it goes on to
        assertEq(committee.judge(judges[0]).owner, address(0));
        _refused(vote, old, _notAJudge(judges[0]));
        judgeKeys[0] = key;
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
    }

    function test_afterAVerdictAKeyThatChangedIsNone() public {
        _settle(CLEANING);
        Vote memory vote = accepting(submitted());
        bytes memory old = signatures(vote, 3);
        (address fresh, uint256 key) = makeAddrAndKey("fresh");
        vm.prank(judges[0]);
        committee.changeKey(judges[0], fresh);
        _refused(vote, old, _notAJudge(judges[0]));
        judgeKeys[0] = key;
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
    }

    function test_afterAVerdictWhoIsUnseatedDoesNotVote() public {
        _settle(CLEANING);
        setQuorum(2, 3, 0, 0x0e); // without judge 0 and 4
        Vote memory vote = accepting(submitted());
        _refused(
            vote, abi.encodePacked(sign(judgeKeys[0], vote), sign(judgeKeys[1], vote)), _notAJudge(judges[0])
        );
        committee.postVotes(
            vote, REPORT_URI, abi.encodePacked(sign(judgeKeys[1], vote), sign(judgeKeys[2], vote))
        );
        setQuorum(VOTES, JUDGES, 0, ALL);
        _settle(CLEANING);
    }

    function test_aKeyThatChangedIsNoneForEachKindOfItsJudge() public {
        bytes32[4] memory kinds = [CLEANING, CHARGING, bytes32("third"), bytes32("fourth")];
        uint64[4] memory who = [ALL, 0x1e, 0x07, 0x0f];
        for (uint256 i = 1; i < 4; ++i) {
            vm.startPrank(admin);
            organization.setAudit(kinds[i], AUDIT_WINDOW, Silence.Executor);
            organization.allowKind(kinds[i], Review.Oracle, RULES);
            committee.setQuorum(kinds[i], 2, 3, 1, who[i]);
            vm.stopPrank();
        }
        setQuorum(2, 3, 1, ALL);
        for (uint256 i = 0; i < 4; ++i) {
            _ready(kinds[i]);
        }
        skip(JUDGES); // so that all are in the panel
        address fresh = makeAddr("fresh");
        vm.prank(admin);
        committee.changeKey(judges[0], fresh);
        for (uint256 i = 0; i < 4; ++i) {
            Vote memory vote = _accepting(kinds[i]);
            _refused(
                vote,
                signatures(vote, 2),
                abi.encodeWithSelector(IOracleCommittee.NotAJudge.selector, judges[0], kinds[i])
            );
            committee.postVotes(
                vote, REPORT_URI, abi.encodePacked(sign(judgeKeys[1], vote), sign(judgeKeys[2], vote))
            );
        }
    }

    function test_theAdministratorTakesAStolenKeyBack() public {
        address thief = makeAddr("thief");
        address fresh = makeAddr("fresh");
        vm.prank(judges[0]);
        committee.changeKey(judges[0], thief);
        vm.prank(admin);
        committee.changeKey(thief, fresh);
        assertEq(committee.keyOf(0), fresh);
    }

    function test_nobodyElseChangesAKey() public {
        vm.prank(judges[1]);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.NotAdministrator.selector, judges[1]));
        committee.changeKey(judges[0], stranger);
    }

    function test_aSeatHasOneKeyAndAKeyOneSeat() public {
        vm.startPrank(admin);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.AlreadySeated.selector, judges[1]));
        committee.changeKey(judges[0], judges[1]);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.AlreadySeated.selector, judges[1]));
        committee.seat(judges[1], bob);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.InvalidJudge.selector, stranger, address(0)));
        committee.changeKey(stranger, bob);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.InvalidJudge.selector, judges[0], judges[0]));
        committee.changeKey(judges[0], address(0));
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.InvalidJudge.selector, address(0), bob));
        committee.seat(address(0), bob);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.InvalidJudge.selector, bob, address(0)));
        committee.seat(bob, address(0));
        assertEq(committee.keyOf(JUDGES), address(0));
    }

    function test_onlyTheAdministratorSeatsAndSetsAQuorum() public {
        bytes memory refused = abi.encodeWithSelector(IOracleCommittee.NotAdministrator.selector, stranger);
        vm.startPrank(stranger);
        vm.expectRevert(refused);
        committee.seat(bob, bob);
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
                    IOracleCommittee.InvalidQuorum.selector, CLEANING, votes[i], panel[i], count[i]
                )
            );
            committee.setQuorum(CLEANING, votes[i], panel[i], 0, who[i]);
        }
        committee.setQuorum(CLEANING, 2, 3, 60, 0x15);
        Quorum memory quorum = committee.quorumOf(CLEANING);
        assertEq(abi.encode(quorum), abi.encode(Quorum(2, 3, 60, 3, 0x15)));
    }

    function test_aCommitteeHasSixtyFourSeats() public {
        vm.startPrank(admin);
        for (uint160 i = JUDGES; i < 64; ++i) {
            committee.seat(address(i + 1000), bob);
        }
        committee.setQuorum(CLEANING, 33, 64, 0, type(uint64).max);
        Judge memory last = committee.judge(address(1063));
        assertEq(last.seat, 63);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.TooManyJudges.selector, 64));
        committee.seat(bob, bob);
    }

    function test_ofSixtyFourJudgesAllVote() public {
        uint256[] memory keys = new uint256[](64);
        vm.startPrank(admin);
        for (uint8 i = 0; i < 64; ++i) {
            if (i < JUDGES) {
                keys[i] = judgeKeys[i];
                continue;
            }
            address key;
            (key, keys[i]) = makeAddrAndKey(string.concat("judge", vm.toString(i)));
            committee.seat(key, makeAddr(string.concat("owner", vm.toString(i))));
        }
        committee.setQuorum(CLEANING, 64, 64, 0, type(uint64).max);
        vm.stopPrank();
        Vote memory vote = accepting(submitted());
        bytes memory all;
        for (uint256 i = 64; i > 0; --i) {
            all = abi.encodePacked(all, sign(keys[i - 1], vote));
        }
        vm.expectEmit(address(committee));
        emit IOracleCommittee.VotesCounted(vote.taskId, 1, RULES, type(uint64).max);
        committee.postVotes(vote, REPORT_URI, all);
    }

    /// @dev Nobody knew that it would count votes, so that the verdict does not say who is a party.
    function test_aCommitteeThatIsMadeAfterItGotItsRoleKnowsThePartiesToo() public {
        bytes32 role = organization.ORACLE_ROLE();
        address later = vm.computeCreateAddress(address(this), vm.getNonce(address(this)));
        vm.prank(admin);
        organization.grantRole(role, later);
        committee = new OracleCommittee(organization);
        assertEq(address(committee), later);
        (, uint256 ofRobot1) = makeAddrAndKey("robot1");
        (, uint256 ofRobot2) = makeAddrAndKey("robot2");
        vm.startPrank(admin);
        address[4] memory keys = [judges[0], judges[1], robot1, robot2];
        for (uint256 i = 0; i < 4; ++i) {
            committee.seat(keys[i], keys[i]);
        }
        committee.setQuorum(CLEANING, 2, 3, 0, 0x0f);
        vm.stopPrank();
        Vote memory vote = accepting(submitted());
        _refused(vote, abi.encodePacked(sign(ofRobot1, vote), signatures(vote, 1)), _isParty(vote, robot1));
        address company = makeAddr("company");
        vm.startPrank(admin);
        Possession.register(organization, alice, "wallet", company, "alice");
        Possession.register(organization, robot2, "wallet", company, "robot2");
        vm.stopPrank();
        _refused(vote, abi.encodePacked(sign(ofRobot2, vote), signatures(vote, 1)), _isParty(vote, robot2));
        committee.postVotes(vote, REPORT_URI, signatures(vote, 2));
        assertState(vote.taskId, TaskState.Settled);
    }

    // -- help -------------------------------------------------------------------------------------------------

    function _refused(Vote memory vote, bytes memory votes, bytes memory expected) private {
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

    /// @dev The committee has accepted one.
    function _settle(bytes32 kind) private {
        _ready(kind);
        Vote memory vote = accepting(taskNo(tasks.taskCount()));
        committee.postVotes(vote, REPORT_URI, signatures(vote, 3));
    }

    /// @dev Of the task of this kind.
    function _accepting(bytes32 kind) private view returns (Vote memory) {
        TaskId taskId = taskNo(1);
        while (tasks.task(taskId).kind != kind) {
            taskId = following(taskId);
        }
        return accepting(taskId);
    }

    /// @dev Judge 0 to 2, and one more that works for `owner`.
    function _withJudgeOf(address owner, Vote memory vote) private returns (bytes memory) {
        (address key, uint256 secret) = makeAddrAndKey(string.concat("judge of ", vm.toString(owner)));
        vm.prank(admin);
        uint8 number = committee.seat(key, owner);
        setQuorum(4, number + 1, 0, uint64((1 << (number + 1)) - 1));
        return abi.encodePacked(signatures(vote, 3), sign(secret, vote));
    }

    function _refusedWithOwner(address owner) private {
        Vote memory vote = accepting(submitted());
        bytes memory votes = _withJudgeOf(owner, vote);
        address key = makeAddr(string.concat("judge of ", vm.toString(owner)));
        _refused(vote, votes, _isParty(vote, key));
    }

    function _notAJudge(address key) private pure returns (bytes memory) {
        return abi.encodeWithSelector(IOracleCommittee.NotAJudge.selector, key, CLEANING);
    }

    function _isParty(Vote memory vote, address key) private pure returns (bytes memory) {
        return abi.encodeWithSelector(ITaskManager.JudgeIsParty.selector, vote.taskId, key);
    }

    function _notInPanel(Vote memory vote, address key, uint256 place, uint256 panel)
        private
        pure
        returns (bytes memory)
    {
        return abi.encodeWithSelector(IOracleCommittee.NotInPanel.selector, vote.taskId, key, place, panel);
    }
}
