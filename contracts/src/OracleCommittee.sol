// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {ECDSA} from "@openzeppelin/contracts/utils/cryptography/ECDSA.sol";
import {EIP712} from "@openzeppelin/contracts/utils/cryptography/EIP712.sol";
import {IOracleCommittee, Judge, Quorum} from "./interfaces/IOracleCommittee.sol";
import {IOrganization} from "./interfaces/IOrganization.sol";
import {IServiceManager} from "./interfaces/IServiceManager.sol";
import {ITaskManager, TaskState, Verdict, Vote} from "./interfaces/ITaskManager.sol";
import {KindId, NO_KIND} from "./types/KindId.sol";
import {NO_PARTIES, Parties} from "./types/Parties.sol";
import {Submission} from "./types/Submission.sol";
import {TaskId} from "./types/TaskId.sol";

contract OracleCommittee is IOracleCommittee, EIP712 {
    /// @dev What the votes on a submission have to fit. All of it is read once, whatever the number of votes.
    struct Question {
        Submission submission;
        Parties parties;
        Quorum quorum;
    }

    /// @notice As many as Quorum.judges has bits.
    uint256 public constant MAX_JUDGES = 64;

    /// @notice Each day another judge is the first in line.
    uint256 public constant TURN = 1 days;

    /// @dev r, and s with its parity: EIP-2098.
    uint256 private constant SIGNATURE_BYTES = 64;
    bytes32 private constant ADMINISTRATOR = 0;
    bytes32 private constant VOTE_TYPEHASH = keccak256(
        "Vote(uint256 taskId,uint8 attempt,bytes32 proofHash,bytes32 reportHash,bytes32 rulesHash,"
        "uint8 verdict,uint256 amount,string reason)"
    );

    /// @inheritdoc IOracleCommittee
    IOrganization public immutable organization;
    /// @inheritdoc IOracleCommittee
    ITaskManager public immutable tasks;
    IServiceManager private immutable _services;

    address[] private _keys;
    mapping(address key => Judge) private _judges;
    mapping(KindId kindId => Quorum) private _quorums;

    modifier onlyAdministrator() {
        if (!_isAdministrator(msg.sender)) revert NotAdministrator(msg.sender);
        _;
    }

    constructor(IOrganization organization_) EIP712("RODEO OracleCommittee", "1") {
        organization = organization_;
        tasks = organization_.tasks();
        _services = organization_.services();
    }

    /// @inheritdoc IOracleCommittee
    function seat(address key, address owner) external onlyAdministrator returns (uint8 seatNumber) {
        if (key == address(0) || owner == address(0)) revert InvalidJudge(key, owner);
        if (_judges[key].owner != address(0)) revert AlreadySeated(key);
        if (_keys.length == MAX_JUDGES) revert TooManyJudges(MAX_JUDGES);
        seatNumber = uint8(_keys.length);
        _keys.push(key);
        _judges[key] = Judge(owner, seatNumber);
        emit JudgeSeated(seatNumber, key, owner);
    }

    /// @inheritdoc IOracleCommittee
    function setQuorum(bytes32 kind, uint8 votes, uint8 panel, uint32 rotation, uint64 judges)
        external
        onlyAdministrator
    {
        uint8 count = _count(judges);
        bool seated = _keys.length == MAX_JUDGES || judges >> _keys.length == 0;
        // More than half, so that two verdicts on one proof need a judge who votes for both. With a rotation that holds
        // only while the panel is that small: it grows to all judges, of whom two groups may then have enough votes.
        if (uint256(votes) * 2 <= panel || votes > panel || panel > count || !seated) {
            revert InvalidQuorum(kind, votes, panel, count);
        }
        KindId kindId = organization.numberOf(kind);
        if (kindId == NO_KIND) revert IOrganization.UnknownKind(kind);
        _quorums[kindId] = Quorum(votes, panel, rotation, count, judges);
        emit QuorumChanged(kind, votes, panel, rotation, judges);
    }

    /// @inheritdoc IOracleCommittee
    function changeKey(address oldKey, address key) external {
        if (msg.sender != oldKey && !_isAdministrator(msg.sender)) revert NotAdministrator(msg.sender);
        Judge memory sitting = _judges[oldKey];
        if (sitting.owner == address(0) || key == address(0)) revert InvalidJudge(oldKey, sitting.owner);
        if (_judges[key].owner != address(0)) revert AlreadySeated(key);
        delete _judges[oldKey];
        _judges[key] = sitting;
        _keys[sitting.seat] = key;
        emit JudgeKeyChanged(sitting.seat, oldKey, key);
    }

    /// @inheritdoc IOracleCommittee
    function postVotes(Vote calldata vote, string calldata reportUri, bytes calldata signatures) external {
        // The verdict goes first: TaskManager, which reads the task once, answers with what the votes have to fit. Unless
        // they do, nothing of this happens.
        (Submission judged, Parties parties) = _postVerdict(vote, reportUri);
        // What was left undecided is for auditors alone.
        if (judged.submitted() == 0) {
            revert ITaskManager.WrongState(vote.taskId, TaskState.Undecided, TaskState.Submitted);
        }
        _countVotes(vote, judged, parties, signatures);
    }

    /// @inheritdoc IOracleCommittee
    function countVoters(Vote calldata vote, bytes calldata signatures) external returns (uint64) {
        (Submission submission, Parties parties) = tasks.toJudge(vote.taskId);
        bytes32 kind = organization.kindNumbered(submission.kindId());
        if (!organization.mayJudge(msg.sender, kind)) revert ITaskManager.NotJudge(msg.sender, kind);
        return _countVotes(vote, submission, parties, signatures);
    }

    /// @inheritdoc IOracleCommittee
    function judge(address key) external view returns (Judge memory) {
        return _judges[key];
    }

    /// @inheritdoc IOracleCommittee
    function keyOf(uint8 seatNumber) external view returns (address) {
        return seatNumber < _keys.length ? _keys[seatNumber] : address(0);
    }

    /// @inheritdoc IOracleCommittee
    function quorumOf(bytes32 kind) external view returns (Quorum memory) {
        return _quorums[organization.numberOf(kind)];
    }

    /// @inheritdoc IOracleCommittee
    function digestOf(Vote calldata vote) public view returns (bytes32) {
        return _hashTypedDataV4(
            keccak256(
                abi.encode(
                    VOTE_TYPEHASH,
                    vote.taskId,
                    vote.attempt,
                    vote.proofHash,
                    vote.reportHash,
                    vote.rulesHash,
                    vote.verdict,
                    vote.amount,
                    keccak256(bytes(vote.reason))
                )
            )
        );
    }

    function _postVerdict(Vote calldata vote, string calldata reportUri)
        private
        returns (Submission, Parties)
    {
        return tasks.postVerdict(
            vote.taskId,
            vote.attempt,
            vote.proofHash,
            vote.verdict,
            vote.amount,
            vote.reportHash,
            reportUri,
            vote.reason
        );
    }

    /// @param parties NO_PARTIES if TaskManager does not know them, see IServiceManager.rightOf
    function _countVotes(
        Vote calldata vote,
        Submission submission,
        Parties parties,
        bytes calldata signatures
    ) private returns (uint64 voters) {
        Quorum memory quorum = _quorums[submission.kindId()];
        if (quorum.votes == 0) revert KindWithoutQuorum(organization.kindNumbered(submission.kindId()));
        if (parties == NO_PARTIES) {
            parties = _services.partiesOf(submission.serviceId(), submission.creator());
        }
        voters = _voters(vote, Question(submission, parties, quorum), signatures);
        emit VotesCounted(vote.taskId, vote.attempt, vote.rulesHash, voters);
    }

    /// @dev One bit for each seat that signed the vote, all of which may judge the task, and enough of them.
    function _voters(Vote calldata vote, Question memory q, bytes calldata signatures)
        private
        view
        returns (uint64 voters)
    {
        if (signatures.length % SIGNATURE_BYTES != 0) revert InvalidSignatures(signatures.length);
        uint256 votes = signatures.length / SIGNATURE_BYTES;
        if (votes < q.quorum.votes) revert TooFewVotes(vote.taskId, votes, q.quorum.votes);
        bytes32 digest = digestOf(vote);
        for (uint256 i = 0; i < signatures.length; i += SIGNATURE_BYTES) {
            (bytes32 r, bytes32 vs) = abi.decode(signatures[i:i + SIGNATURE_BYTES], (bytes32, bytes32));
            // Refuses the second signature that anybody can compute from a first. See EIP-2. Where it fails the
            // key is 0, which is no judge's.
            // slither-disable-next-line unused-return
            (address key,,) = ECDSA.tryRecover(digest, r, vs);
            uint64 bit = _requireJudge(vote, q, key);
            if (voters & bit != 0) revert VotedTwice(vote.taskId, key);
            voters |= bit;
        }
    }

    /// @dev The bit of the judge with `key`, who may vote on the task now.
    function _requireJudge(Vote calldata vote, Question memory q, address key)
        private
        view
        returns (uint64 bit)
    {
        Judge memory sitting = _judges[key];
        address owner = sitting.owner;
        bit = _bitOf(sitting.seat);
        if (owner == address(0) || q.quorum.judges & bit == 0) {
            revert NotAJudge(key, organization.kindNumbered(q.submission.kindId()));
        }
        // The registry may know another owner than the seat.
        if (_isParty(q, key) || (owner != key && _isParty(q, owner))) {
            revert ITaskManager.JudgeIsParty(vote.taskId, key);
        }
        if (vote.verdict == Verdict.Undecided && organization.mayAudit(key)) {
            revert JudgeIsAuditor(vote.taskId, key);
        }
        if (q.quorum.panel < q.quorum.count) _requireInPanel(vote.taskId, q, bit, key);
    }

    /// @dev The line begins with another judge each day, and the panel grows while judges are absent.
    /// @param bit of the judge's seat
    function _requireInPanel(TaskId taskId, Question memory q, uint64 bit, address key) private view {
        (uint256 submitted, uint256 panel, uint256 count) =
            (q.submission.submitted(), q.quorum.panel, q.quorum.count);
        if (q.quorum.rotation != 0) panel += (block.timestamp - submitted) / q.quorum.rotation;
        uint256 first = (submitted / TURN) % count;
        // Judges of the kind stand in line in order of their seats.
        uint256 place = (_count(q.quorum.judges & (bit - 1)) + count - first) % count;
        if (place >= panel) revert NotInPanel(taskId, key, place, panel);
    }

    function _isParty(Question memory q, address account) private view returns (bool) {
        if (account == q.submission.creator() || account == q.parties.provider()) return true;
        return
            q.parties.others() && _services.isParty(account, q.submission.serviceId(), q.submission.creator());
    }

    function _isAdministrator(address account) private view returns (bool) {
        return IAccessControl(address(organization)).hasRole(ADMINISTRATOR, account);
    }

    /// @dev What stands for a seat in Quorum.judges.
    function _bitOf(uint8 seatNumber) private pure returns (uint64) {
        return uint64(1 << seatNumber);
    }

    /// @dev How many bits are set.
    function _count(uint64 bits) private pure returns (uint8 count) {
        for (; bits != 0; bits &= bits - 1) {
            ++count;
        }
    }
}
