// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {TaskId} from "../types/TaskId.sol";
import {ICommitteeJudge} from "./ICommitteeJudge.sol";
import {Finding, IJudge} from "./IJudge.sol";
import {Fault, Ruling} from "./ITaskManager.sol";

/// @notice One committee of those that judge a kind one after the other.
/// @param committee whose judges vote
/// @param window how long its ruling can be challenged, s; of the last one 0
/// @param decision how long it may take over a challenge, s; of the first one 0
/// @param stake what a challenge of its ruling costs whoever is wrong, in the token's smallest unit; of the last one 0
/// @param judgeStake what each judge must have deposited for its vote to count, and loses if a later instance overturns
/// the ruling, in the token's smallest unit; 0 for none, as of the last one, which nothing overturns
struct Instance {
    ICommitteeJudge committee;
    uint32 window;
    uint32 decision;
    uint96 stake;
    uint96 judgeStake;
}

/// @param reportHash SHA-256 of the report
/// @param ruling what the instance said
/// @param fault whose fault a void is
/// @param paid what the executor is paid by it
/// @param voters one bit for each seat of its committee that voted for it
/// @param windowEnd until when it can be challenged, block time in seconds; 0 for the last instance
/// @param until when it stands for good, unless the next instance replaces it: `windowEnd`, or later if it is challenged
/// @param challenger who staked against it; 0 if nobody did
struct InstanceRuling {
    bytes32 reportHash;
    Ruling ruling;
    Fault fault;
    uint96 paid;
    uint64 voters;
    uint40 windowEnd;
    uint40 until;
    address challenger;
}

/// @title Rulings that can be challenged.
/// @notice A ruling of the first instance stands for a window. In it a party to the task (for the organization an operator)
/// or one of the kind's judges may challenge it with a stake; then it stands longer, and the next instance may replace it,
/// and so on to the last, which is final. When the case is over, anybody has the stakes settled: a challenger whom the end
/// proves right has its stake back, the stake of one whom it proves wrong goes to the other party, and the judges of a ruling
/// that was overturned lose theirs to the organization's treasury. Where the organization took the right to judge from this
/// contract, all stakes go back.
/// @dev Each step has an end in block time, and the last one comes before the case's own end. What this contract holds can
/// be settled whatever becomes of the task.
/// The stake of a judge belongs to its seat, so it stays when the key changes. It stands for ten times its amount that
/// open rulings pay, accepted or impossible. `committee` and `seat` say which judge's it is. Rejections lock none of it, so that whoever posts garbage does not use up the judges.
interface IDisputeJudge is IJudge {
    event InstancesChanged(bytes32 indexed kind, Instance[] instances);
    /// @param ruling None if the first instance passes the case on
    /// @param rules by which the judges say that they judged
    /// @param voters one bit for each seat of the instance's committee
    /// @param until when the ruling stands for good, unless somebody challenges it; 0: it is final, or passed on
    event InstanceRuled(
        TaskId indexed taskId,
        uint8 attempt,
        uint8 indexed instance,
        Ruling ruling,
        bytes32 rules,
        uint64 voters,
        uint256 until
    );
    /// @notice The next instance decides until `until`, else the ruling stands.
    event Challenged(
        TaskId indexed taskId,
        uint8 indexed instance,
        address indexed challenger,
        uint256 stake,
        uint256 until,
        string reason
    );
    /// @notice The stakes of the case are free or paid.
    /// @param voided because this contract judges no more
    event CaseSettled(TaskId indexed taskId, uint8 attempt, bool voided);
    /// @param account who got it: the challenger or its opponent, or the payout address of either; the organization for
    /// what its judges lost
    event StakePaid(TaskId indexed taskId, address indexed account, uint256 amount);
    /// @notice The token refused it; see withdrawPayments.
    event StakeDeferred(address indexed account, uint256 amount);
    /// @param committee any contract: a judge's stake counts only where an instance names its committee
    /// @param payer whose tokens they were
    event StakeDeposited(
        ICommitteeJudge indexed committee, uint8 indexed seat, address indexed payer, uint256 amount
    );
    /// @notice That much counts no more for votes. It can be paid out after `until`.
    event WithdrawalAnnounced(
        ICommitteeJudge indexed committee, uint8 indexed seat, uint256 amount, uint256 until
    );
    /// @param account who got it: the seat's owner, or its payout address
    event StakeWithdrawn(
        ICommitteeJudge indexed committee, uint8 indexed seat, address indexed account, uint256 amount
    );
    /// @notice The judge voted for a ruling that was overturned.
    event StakeLost(
        TaskId indexed taskId, ICommitteeJudge indexed committee, uint8 indexed seat, uint256 amount
    );

    error InvalidInstances(bytes32 kind, uint256 index);
    /// @notice Somebody would decide about its own ruling.
    error JudgesTwice(bytes32 kind, address key);
    /// @notice A case would be longer than the verdict window that the organization asks for because of this judge.
    error CaseTooLong(bytes32 kind, uint256 longest, uint256 window);
    error KindWithoutInstances(bytes32 kind);
    /// @notice Too little of the case is left for challenges.
    error TooLate(TaskId taskId, uint256 needed, uint256 caseEnd);
    /// @notice A ruling stands already, and nobody has challenged it.
    error NotChallenged(TaskId taskId);
    /// @notice The ruling is before the next instance, and only a party may take a challenge over from a judge.
    error ChallengedBefore(TaskId taskId, address challenger);
    /// @notice A later instance cannot pass a challenge on.
    error MustDecide(TaskId taskId);
    /// @notice Meanwhile this instance of this attempt has ruled.
    error AnotherRuling(TaskId taskId, uint8 attempt, uint8 instance);
    error NoCase(TaskId taskId, uint8 attempt);
    error WindowOver(TaskId taskId, uint256 until, uint256 time);
    error WindowNotOver(TaskId taskId, uint256 until, uint256 time);
    error NeitherPartyNorJudge(TaskId taskId, address account);
    error NothingOwed(address account);
    /// @notice Only the contract itself calls this function.
    error NotItself(address account);
    /// @notice The token took a fee, or moved nothing.
    error WrongStakeReceived(uint256 expected, uint256 received);
    error NoJudge(ICommitteeJudge committee, uint8 seat);
    error NotOwner(address account, address owner);
    /// @notice A stake that is being withdrawn does not count, nor does one that stands for open rulings.
    error StakeTooLow(ICommitteeJudge committee, uint8 seat, uint256 stake, uint256 needed);
    error NoWithdrawal(ICommitteeJudge committee, uint8 seat);
    error WithdrawalTooEarly(ICommitteeJudge committee, uint8 seat, uint256 until, uint256 time);

    // -- administrator ------------------------------------------------------------------------------------

    /// @notice Say who judges `kind` from now on. Cases that run keep what they began with. While this contract judges a number of
    /// the kind, cases become no longer than the windows of its tasks allow (CaseTooLong).
    /// @param instances one to three, in their order, of different judges; each later one needs more votes and a
    /// greater stake than the one before. Each committee needs its quorum for the kind first.
    function setInstances(bytes32 kind, Instance[] calldata instances) external;

    // -- anybody ------------------------------------------------------------------------------------------

    /// @notice Bring the ruling of the instance whose turn it is. What the first one cannot decide goes to `next`. One vote
    /// of a judge whose stake is too low fails all of it (StakeTooLow), so leave that vote out.
    /// @param finding what its judges signed
    /// @param reportUri where the report lies
    /// @param signatures of different judges in any order, 64 bytes each (EIP-2098)
    function postVotes(Finding calldata finding, string calldata reportUri, bytes calldata signatures)
        external;

    /// @notice Free and pay the stakes of a case that is over.
    function settle(TaskId taskId, uint8 attempt) external;

    /// @notice Pay `account`, or its payout address, what the token refused before.
    function withdrawPayments(address account) external;

    /// @notice Only this contract calls it, to undo a payment that the token refuses, whatever the token did.
    /// @param to the account that is paid
    /// @param amount in the token's smallest unit
    function payOrRevert(address to, uint256 amount) external;

    /// @notice Add to the stake of a judge, by the caller's allowance for this contract. It is the judge's from then on.
    /// @param amount in the token's smallest unit
    function depositStake(ICommitteeJudge committee, uint8 seat, uint256 amount) external;

    /// @notice Pay the seat's owner, or its payout address, what was announced and is left of it.
    function withdrawStake(ICommitteeJudge committee, uint8 seat) external;

    // -- who owns a judge ---------------------------------------------------------------------------------

    /// @notice Begin to take a stake back. It counts no more for votes, but can still be lost for votes that were counted
    /// before. What stands for open rulings stays. Announcing again adds to what was announced, and begins the time anew.
    /// Only the owner of the seat: whoever takes the judge's key gets nothing by it.
    /// @param amount in the token's smallest unit
    function announceWithdrawal(ICommitteeJudge committee, uint8 seat, uint256 amount) external;

    // -- a party or a judge -------------------------------------------------------------------------------

    /// @notice Have the next instance decide. The caller's stake is taken by its allowance for this contract. A party may
    /// take over what a judge has challenged, in the same window; the judge's stake goes back. Whoever has no gas signs the
    /// same for ISignedRequests.challengeFor.
    /// @param taskId whose ruling
    /// @param attempt which attempt at it
    /// @param instance whose ruling it is, counted from 0: a late call is against no other one
    /// @param reason why it is wrong, as people read it
    function challenge(TaskId taskId, uint8 attempt, uint8 instance, string calldata reason) external;

    // -- views --------------------------------------------------------------------------------------------

    /// @notice Returns who judges `kind`, in the order of the instances.
    function instancesOf(bytes32 kind) external view returns (Instance[] memory);

    /// @notice Returns how long a case of this kind lasts at most after the first ruling, s.
    function longestCase(bytes32 kind) external view returns (uint256);

    /// @notice Returns the rulings so far; none where there is no case, or it was settled.
    /// @return rulings in the order of the instances
    /// @return challenged whether the last of them is before the next instance
    /// @return until the end of the running window
    function caseOf(TaskId taskId, uint8 attempt)
        external
        view
        returns (InstanceRuling[] memory rulings, bool challenged, uint256 until);

    /// @notice Returns what waits for `account` in withdrawPayments.
    function pendingPayments(address account) external view returns (uint256);

    /// @notice Returns what is deposited for a judge.
    /// @return stake what counts for its votes
    /// @return open what its rulings pay, accepted or impossible, in cases that are not settled: at most ten times the stake
    /// @return leaving what is being withdrawn, which can be lost, too
    /// @return until when that can be paid out, block time in s
    function stakeOf(ICommitteeJudge committee, uint8 seat)
        external
        view
        returns (uint256 stake, uint256 open, uint256 leaving, uint256 until);
}
