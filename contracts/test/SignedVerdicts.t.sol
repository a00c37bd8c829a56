// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IOracleCommittee} from "../src/interfaces/IOracleCommittee.sol";
import {Review} from "../src/interfaces/IOrganization.sol";
import {
    ITaskManager,
    SignedBy,
    Silence,
    Task,
    TaskState,
    Verdict,
    Vote
} from "../src/interfaces/ITaskManager.sol";
import {SignedVerdicts} from "../src/libraries/SignedVerdicts.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Committee} from "./Committee.sol";
import {Possession} from "./Possession.sol";

/// @notice A wallet that takes every call, and answers with a word if it is told to.
contract Wallet {
    bytes private _answer;

    constructor(bytes memory answer) {
        _answer = answer;
    }

    fallback(bytes calldata) external returns (bytes memory) {
        return _answer;
    }
}

/// @notice The executor brings the verdict along with the proof: of one oracle, and of a committee of five.
contract SignedVerdictsTest is Committee {
    string private constant REPORT_URI = "https://store/report.json";
    /// @dev Of secp256k1: s and N - s both verify.
    uint256 private constant N = 0xFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFEBAAEDCE6AF48A03BBFD25E8CD0364141;

    address private _signer;
    uint256 private _key;
    TaskId private _taskId;

    function setUp() public override {
        super.setUp();
        (_signer, _key) = makeAddrAndKey("the oracle that signs");
        _grant(organization.ORACLE_ROLE(), _signer);
        offer(robot1, 80 ether);
        _taskId = post(alice, 100 ether);
    }

    // -- verdicts that count --------------------------------------------------------------------------------

    function test_aTaskTakesTwoTransactions() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        vm.expectEmit(address(tasks));
        emit ITaskManager.ProofSubmitted(_taskId, 1, robot1, PROOF, URI, block.timestamp + WINDOW);
        vm.expectEmit(address(tasks));
        emit ITaskManager.VerdictSigned(_taskId, 1, _signer, RULES);
        vm.expectEmit(address(tasks));
        emit ITaskManager.VerdictPosted(
            _taskId, 1, PROOF, Verdict.Accepted, 80 ether, REPORT, REPORT_URI, "accepted"
        );
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskSettled(_taskId, robot1, 80 ether, 20 ether);
        _submit(vote, by);
        assertState(_taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), 2080 ether);
        assertEq(coin.balanceOf(alice), 1920 ether);
        assertEq(tasks.held(), 0);
    }

    function test_theVotesOfACommitteeAreBroughtAlong() public {
        (Vote memory vote, SignedBy memory by) = _voted(VOTES);
        vm.expectEmit(address(committee));
        emit IOracleCommittee.VotesCounted(_taskId, 1, RULES, 7);
        vm.expectEmit(address(tasks));
        emit ITaskManager.VerdictSigned(_taskId, 1, address(committee), RULES);
        _submit(vote, by);
        assertState(_taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    function test_aSignedVerdictMayRejectPayAPartOrCallItImpossible() public {
        Vote memory vote = accepting(_taskId);
        (vote.verdict, vote.amount) = (Verdict.Rejected, 0);
        _submit(vote, _by(vote));
        assertEq(tasks.task(_taskId).attempt, 2);
        vote = accepting(_taskId);
        vote.amount = 1 ether;
        _submit(vote, _by(vote));
        assertEq(coin.balanceOf(robot1), 2001 ether);
        _taskId = post(alice, 100 ether);
        vote = accepting(_taskId);
        (vote.verdict, vote.amount) = (Verdict.Impossible, 0);
        _submit(vote, _by(vote));
        assertEq(coin.balanceOf(robot1), 2009 ether);
    }

    /// @dev The proof waits for the auditors although it was kept nowhere before, and its signer is none of them.
    function test_attack_whoSignedUndecidedDecidesAsAuditor() public {
        Vote memory vote = accepting(_taskId);
        (vote.verdict, vote.amount) = (Verdict.Undecided, 0);
        _submit(vote, _by(vote));
        assertState(_taskId, TaskState.Undecided);
        assertEq(tasks.task(_taskId).proofHash, PROOF);
        _grant(organization.AUDITOR_ROLE(), _signer);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.JudgedBefore.selector, _taskId, _signer));
        vm.prank(_signer);
        tasks.postVerdict(_taskId, 1, PROOF, Verdict.Accepted, 80 ether, REPORT, "", "");
        judgeAs(auditor, _taskId, Verdict.Accepted, 80 ether);
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    // -- signatures that count for nothing --------------------------------------------------------------------

    /// @dev Whatever is changed in what was signed, it is signed by nobody.
    function test_attack_aSignedVerdictIsChanged() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        for (uint256 i = 0; i < 7; ++i) {
            (Vote memory other, SignedBy memory same) = (accepting(_taskId), by);
            if (i == 0) other.proofHash = keccak256("another recording");
            if (i == 1) other.reportHash = keccak256("another report");
            if (i == 2) other.rulesHash = keccak256("other rules");
            if (i == 3) other.amount = 79 ether;
            if (i == 4) (other.verdict, other.amount) = (Verdict.Impossible, 0);
            if (i == 5) other.reason = "another reason";
            if (i == 6) same = SignedBy(by.judge, by.deadline + 1, by.reportUri, by.signatures);
            _expectNotSigned(_signer);
            _submit(other, same);
        }
        _submit(vote, by);
    }

    function test_attack_aSignedVerdictIsUsedForAnotherTask() public {
        (, SignedBy memory by) = _signed();
        offer(robot1, 80 ether);
        TaskId other = post(bob, 100 ether);
        Vote memory vote = accepting(other);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotSigned.selector, other, _signer));
        _submit(vote, by);
    }

    function test_attack_aSignedVerdictIsUsedForTheNextAttempt() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        vm.prank(robot1);
        tasks.abandonTask(_taskId, 1);
        assertEq(tasks.task(_taskId).attempt, 2);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.WrongAttempt.selector, _taskId, 2, 1));
        _submit(vote, by);
        vote.attempt = 2;
        _expectNotSigned(_signer);
        _submit(vote, by);
    }

    function test_attack_aSignedVerdictIsUsedTwice() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        _submit(vote, by);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, _taskId, TaskState.Settled, TaskState.Assigned
            )
        );
        _submit(vote, by);
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    function test_attack_aSignedVerdictIsUsedOnAnotherChain() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        vm.chainId(4242);
        _expectNotSigned(_signer);
        _submit(vote, by);
    }

    function test_attack_aVerdictForAnotherContractIsUsed() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        by.signatures =
            _signature(_key, SignedVerdicts.digestOf(vote, _signer, by.deadline, address(organization)));
        _expectNotSigned(_signer);
        _submit(vote, by);
    }

    function test_attack_aSignedVerdictIsKeptForLater() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        vm.warp(by.deadline + 1);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.SignatureExpired.selector, _taskId, by.deadline, by.deadline + 1
            )
        );
        _submit(vote, by);
        vm.warp(by.deadline);
        _submit(vote, by);
    }

    /// @dev s and N - s, the wrong length, and what gives no key at all.
    function test_attack_otherFormsOfASignature() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        (uint8 v, bytes32 r, bytes32 s) =
            vm.sign(_key, SignedVerdicts.digestOf(vote, _signer, by.deadline, address(tasks)));
        bytes[4] memory forms;
        forms[0] = abi.encodePacked(r, N - uint256(s) | (v == 27 ? 1 << 255 : 0));
        forms[1] = abi.encodePacked(r, s, v);
        forms[2] = "";
        forms[3] = new bytes(64);
        for (uint256 i = 0; i < forms.length; ++i) {
            by.signatures = forms[i];
            _expectNotSigned(_signer);
            _submit(vote, by);
        }
        by.judge = address(0);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotJudge.selector, address(0), CLEANING));
        _submit(vote, by);
    }

    // -- those who may not judge ------------------------------------------------------------------------------

    function test_attack_aStrangerOrAJudgeOfAnotherKindSigns() public {
        (address other, uint256 key) = makeAddrAndKey("no oracle");
        _expectNoJudge(other, key, ITaskManager.NotJudge.selector);
        _grant(organization.AUDITOR_ROLE(), other);
        _expectNoJudge(other, key, ITaskManager.NotJudge.selector);
    }

    function test_attack_anOracleThatWasDismissedHadSigned() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        bytes32 role = organization.ORACLE_ROLE();
        vm.prank(admin);
        organization.revokeRole(role, _signer);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotJudge.selector, _signer, CLEANING));
        _submit(vote, by);
    }

    function test_attack_creatorOrExecutorSignItsOwnVerdict() public {
        (address robot, uint256 robotsKey) = makeAddrAndKey("a robot that judges");
        (address customer, uint256 customersKey) = makeAddrAndKey("a customer that judges");
        bytes32 role = organization.ORACLE_ROLE();
        _grant(role, robot);
        _grant(role, customer);
        vm.prank(bob);
        coin.transfer(customer, 100 ether);
        vm.prank(customer);
        coin.approve(address(tasks), 100 ether);
        offer(robot, 10 ether);
        _taskId = post(customer, 100 ether);
        Vote memory vote = accepting(_taskId);
        SignedBy memory by = SignedBy(robot, block.timestamp, REPORT_URI, "");
        by.signatures =
            _signature(robotsKey, SignedVerdicts.digestOf(vote, robot, by.deadline, address(tasks)));
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.JudgeIsParty.selector, _taskId, robot));
        _submitAs(robot, vote, by);
        by.judge = customer;
        by.signatures =
            _signature(customersKey, SignedVerdicts.digestOf(vote, customer, by.deadline, address(tasks)));
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.JudgeIsParty.selector, _taskId, customer));
        _submitAs(robot, vote, by);
    }

    /// @dev Nor does the judge itself, to end the attempt with a proof that the executor never made.
    function test_attack_anotherThanTheExecutorBringsThem() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        address[4] memory others = [stranger, alice, robot2, _signer];
        for (uint256 i = 0; i < others.length; ++i) {
            vm.expectRevert(
                abi.encodeWithSelector(ITaskManager.NotExecutor.selector, _taskId, others[i], robot1)
            );
            _submitAs(others[i], vote, by);
        }
    }

    /// @dev A judge whose code is a wallet that takes every call has not signed therefore.
    function test_attack_aJudgesWalletTakesEveryCall() public {
        bytes[3] memory answers = [bytes(""), abi.encode(true), abi.encode(bytes4(0x1626ba7e))];
        bytes32 role = organization.ORACLE_ROLE();
        for (uint256 i = 0; i < answers.length; ++i) {
            address wallet = address(new Wallet(answers[i]));
            _grant(role, wallet);
            Vote memory vote = accepting(_taskId);
            vm.expectRevert();
            _submit(vote, SignedBy(wallet, block.timestamp, REPORT_URI, new bytes(64)));
        }
        assertState(_taskId, TaskState.Assigned);
    }

    function test_attack_anAuditorLeavesItUndecided() public {
        vm.startPrank(admin);
        organization.allowKind(CLEANING, Review.Auditor, 0);
        organization.grantRole(organization.AUDITOR_ROLE(), _signer);
        vm.stopPrank();
        Vote memory vote = accepting(_taskId);
        (vote.verdict, vote.amount) = (Verdict.Undecided, 0);
        SignedBy memory by = _by(vote);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.AuditorMustDecide.selector, _taskId, _signer));
        _submit(vote, by);
    }

    // -- what every proof and verdict have to be ------------------------------------------------------------------

    function test_attack_aSignedVerdictPaysWhatNoneMayPay() public {
        Vote memory vote = accepting(_taskId);
        uint256[2] memory amounts = [uint256(0), 80 ether + 1];
        for (uint256 i = 0; i < amounts.length; ++i) {
            vote.amount = amounts[i];
            SignedBy memory by = _by(vote);
            vm.expectRevert(
                abi.encodeWithSelector(ITaskManager.InvalidAmount.selector, _taskId, amounts[i], 80 ether)
            );
            _submit(vote, by);
        }
        vote.verdict = Verdict.None;
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NoVerdict.selector, _taskId));
        _submit(vote, _by(vote));
    }

    function test_aProofThatIsNoneOrTooLateIsRefused() public {
        Vote memory vote = accepting(_taskId);
        vote.proofHash = 0;
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.EmptyProof.selector, _taskId));
        _submit(vote, _by(vote));
        vote.proofHash = PROOF;
        uint256 end = tasks.task(_taskId).deadline;
        vm.warp(end + 1);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.DeadlinePassed.selector, _taskId, end, end + 1));
        _submit(vote, _by(vote));
    }

    /// @dev The proof is not kept, so the one of the service's last task must not come back.
    function test_attack_theProofBeforeCounts() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        _submit(vote, by);
        assertEq(tasks.task(_taskId).proofHash, 0);
        TaskId next = post(alice, 100 ether);
        bytes32 other = keccak256("another recording");
        vm.prank(robot1);
        tasks.submitProof(next, 1, other, URI);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.ProofMismatch.selector, next, other, PROOF));
        vm.prank(_signer);
        tasks.postVerdict(next, 1, PROOF, Verdict.Accepted, 80 ether, REPORT, "", "");
    }

    // -- committees -----------------------------------------------------------------------------------------

    function test_attack_tooFewVotesOrOneTwice() public {
        (Vote memory vote, SignedBy memory by) = _voted(VOTES - 1);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.TooFewVotes.selector, _taskId, 2, 3));
        _submit(vote, by);
        bytes memory again = _signature(judgeKeys[0], _digest(vote, by));
        by.signatures = abi.encodePacked(by.signatures, again);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.VotedTwice.selector, _taskId, judges[0]));
        _submit(vote, by);
    }

    /// @dev What judges signed for the verdict after the proof is no signature for one with it, nor the other way round.
    function test_attack_votesOfTheOneWayCountTheOther() public {
        Vote memory vote = accepting(_taskId);
        SignedBy memory by =
            SignedBy(address(committee), block.timestamp, REPORT_URI, signatures(vote, VOTES));
        vm.expectPartialRevert(IOracleCommittee.NotAJudge.selector);
        _submit(vote, by);
        (vote, by) = _voted(VOTES);
        vm.prank(robot1);
        tasks.submitProof(_taskId, 1, PROOF, URI);
        vm.expectPartialRevert(IOracleCommittee.NotAJudge.selector);
        committee.postVotes(vote, REPORT_URI, by.signatures);
    }

    /// @dev A key that votes in the committee and judges alone, too, signed one vote.
    function test_attack_aVoteCountsAsAVerdict() public {
        (Vote memory vote, SignedBy memory by) = _voted(1);
        _grant(organization.ORACLE_ROLE(), judges[0]);
        by.judge = judges[0];
        _expectNotSigned(judges[0]);
        _submit(vote, by);
    }

    function test_attack_theExecutorBringsTheVerdictOfItsOwner() public {
        (Vote memory vote, SignedBy memory by) = _signed();
        vm.prank(admin);
        Possession.register(organization, robot1, "wallet", _signer, "robot1");
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.JudgeIsParty.selector, _taskId, _signer));
        _submit(vote, by);
    }

    function test_attack_theExecutorsJudgeVotes() public {
        vm.prank(admin);
        committee.seat(vm.addr(99), robot1);
        setQuorum(1, 1, 0, ALL + 1);
        Vote memory vote = accepting(_taskId);
        SignedBy memory by = SignedBy(address(committee), block.timestamp, REPORT_URI, "");
        by.signatures = _signature(99, _digest(vote, by));
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.JudgeIsParty.selector, _taskId, vm.addr(99)));
        _submit(vote, by);
    }

    /// @dev Whoever could choose the digest could use votes that were signed for something else.
    function test_attack_aStrangerHasVotesCounted() public {
        (Vote memory vote, SignedBy memory by) = _voted(VOTES);
        bytes32 digest = _digest(vote, by);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.NotTaskManager.selector, stranger));
        vm.prank(stranger);
        committee.countVotes(vote, digest, by.signatures);
    }

    // -- helpers --------------------------------------------------------------------------------------------

    function _grant(bytes32 role, address account) private {
        vm.prank(admin);
        organization.grantRole(role, account);
    }

    function _submit(Vote memory vote, SignedBy memory by) private {
        _submitAs(robot1, vote, by);
    }

    function _submitAs(address executor, Vote memory vote, SignedBy memory by) private {
        vm.prank(executor);
        tasks.submitJudgedProof(vote, by, URI);
    }

    function _digest(Vote memory vote, SignedBy memory by) private view returns (bytes32) {
        return SignedVerdicts.digestOf(vote, by.judge, by.deadline, address(tasks));
    }

    function _signature(uint256 key, bytes32 digest) private pure returns (bytes memory) {
        (bytes32 r, bytes32 vs) = vm.signCompact(key, digest);
        return abi.encodePacked(r, vs);
    }

    /// @dev The oracle accepts.
    function _signed() private view returns (Vote memory vote, SignedBy memory by) {
        vote = accepting(_taskId);
        by = _by(vote);
    }

    function _by(Vote memory vote) private view returns (SignedBy memory by) {
        by = SignedBy(_signer, block.timestamp + 10 minutes, REPORT_URI, "");
        by.signatures = _signature(_key, _digest(vote, by));
    }

    /// @dev So many of the committee accept.
    function _voted(uint256 count) private view returns (Vote memory vote, SignedBy memory by) {
        vote = accepting(_taskId);
        by = SignedBy(address(committee), block.timestamp + 10 minutes, REPORT_URI, "");
        for (uint256 i = 0; i < count; ++i) {
            by.signatures = abi.encodePacked(by.signatures, _signature(judgeKeys[i], _digest(vote, by)));
        }
    }

    function _expectNotSigned(address judge) private {
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotSigned.selector, _taskId, judge));
    }

    function _expectNoJudge(address judge, uint256 key, bytes4 error_) private {
        Vote memory vote = accepting(_taskId);
        SignedBy memory by = SignedBy(judge, block.timestamp, REPORT_URI, "");
        by.signatures = _signature(key, _digest(vote, by));
        vm.expectRevert(abi.encodeWithSelector(error_, judge, CLEANING));
        _submit(vote, by);
    }
}
