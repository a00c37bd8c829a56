// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {ECDSA} from "@openzeppelin/contracts/utils/cryptography/ECDSA.sol";
import {EIP712} from "@openzeppelin/contracts/utils/cryptography/EIP712.sol";
import {IOracleCommittee, Judge, Quorum} from "./interfaces/IOracleCommittee.sol";
import {IOrganization} from "./interfaces/IOrganization.sol";
import {IServiceManager} from "./interfaces/IServiceManager.sol";
import {ITaskManager, Verdict, Vote} from "./interfaces/ITaskManager.sol";
import {IVoteCounter} from "./interfaces/IVoteCounter.sol";
import {KindId, NO_KIND} from "./types/KindId.sol";
import {ServiceId} from "./types/ServiceId.sol";
import {TaskId} from "./types/TaskId.sol";

contract OracleCommittee is IOracleCommittee, EIP712 {
    /// @dev A task whose proof waits for its verdict.
    struct Waiting {
        TaskId taskId;
        KindId kindId;
        ServiceId serviceId;
        uint40 submitted;
        address creator;
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

    /// @dev The task manager, or a contract that may itself judge the kind of the task.
    modifier onlyJudging(TaskId taskId) {
        if (msg.sender != address(tasks) && !organization.mayJudge(msg.sender, tasks.task(taskId).kind)) {
            revert NotTaskManager(msg.sender);
        }
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
        _countVotes(vote, digestOf(vote), signatures);
        _post(vote, reportUri);
    }

    /// @inheritdoc IVoteCounter
    function countVotes(Vote calldata vote, bytes32 digest, bytes calldata signatures)
        external
        onlyJudging(vote.taskId)
        returns (bytes4)
    {
        _countVotes(vote, digest, signatures);
        return this.countVotes.selector;
    }

    /// @inheritdoc IOracleCommittee
    function countVoters(Vote calldata vote, bytes32 digest, bytes calldata signatures)
        external
        onlyJudging(vote.taskId)
        returns (uint64)
    {
        return _countVotes(vote, digest, signatures);
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

    function _countVotes(Vote calldata vote, bytes32 digest, bytes calldata signatures)
        private
        returns (uint64 voters)
    {
        voters = _voters(vote, _waiting(vote.taskId), digest, signatures);
        emit VotesCounted(vote.taskId, vote.attempt, vote.rulesHash, voters);
    }

    function _post(Vote calldata vote, string calldata reportUri) private {
        tasks.postVerdict(
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

    /// @dev One bit for each seat that signed the vote, all of which may judge the task, and enough of them.
    function _voters(Vote calldata vote, Waiting memory t, bytes32 digest, bytes calldata signatures)
        private
        view
        returns (uint64 voters)
    {
        Quorum memory quorum = _quorums[t.kindId];
        if (quorum.votes == 0) revert KindWithoutQuorum(organization.kindNumbered(t.kindId));
        if (signatures.length % SIGNATURE_BYTES != 0) revert InvalidSignatures(signatures.length);
        uint256 votes = signatures.length / SIGNATURE_BYTES;
        if (votes < quorum.votes) revert TooFewVotes(vote.taskId, votes, quorum.votes);
        for (uint256 i = 0; i < signatures.length; i += SIGNATURE_BYTES) {
            // Refuses the second signature that anybody can compute from a first. See EIP-2. Where it fails the
            // key is 0, which is no judge's.
            // slither-disable-next-line unused-return
            (address key,,) = ECDSA.tryRecover(
                digest, bytes32(signatures[i:i + 32]), bytes32(signatures[i + 32:i + SIGNATURE_BYTES])
            );
            uint64 bit = _requireJudge(vote, t, quorum, key);
            if (voters & bit != 0) revert VotedTwice(vote.taskId, key);
            voters |= bit;
        }
    }

    /// @dev The bit of the judge with `key`, who may vote on the task now.
    function _requireJudge(Vote calldata vote, Waiting memory t, Quorum memory quorum, address key)
        private
        view
        returns (uint64 bit)
    {
        Judge memory sitting = _judges[key];
        bit = uint64(1 << sitting.seat);
        if (sitting.owner == address(0) || quorum.judges & bit == 0) {
            revert NotAJudge(key, organization.kindNumbered(t.kindId));
        }
        // The registry may know another owner than the seat.
        if (_isParty(t, key) || (sitting.owner != key && _isParty(t, sitting.owner))) {
            revert ITaskManager.JudgeIsParty(vote.taskId, key);
        }
        if (vote.verdict == Verdict.Undecided && organization.mayAudit(key)) {
            revert JudgeIsAuditor(vote.taskId, key);
        }
        if (quorum.panel < quorum.count) _requireInPanel(t, quorum, bit, key);
    }

    /// @dev The line begins with another judge each day, and the panel grows while judges are absent.
    function _requireInPanel(Waiting memory t, Quorum memory quorum, uint64 bit, address key) private view {
        uint256 submitted = t.submitted;
        uint256 panel = quorum.panel;
        if (quorum.rotation != 0) panel += (block.timestamp - submitted) / quorum.rotation;
        uint256 first = (submitted / TURN) % quorum.count;
        uint256 place = (_count(quorum.judges & (bit - 1)) + quorum.count - first) % quorum.count;
        if (place >= panel) revert NotInPanel(t.taskId, key, place, panel);
    }

    function _waiting(TaskId taskId) private view returns (Waiting memory t) {
        t.taskId = taskId;
        (t.creator, t.kindId, t.serviceId, t.submitted) = tasks.toJudge(taskId);
    }

    function _isParty(Waiting memory t, address account) private view returns (bool) {
        return _services.isParty(account, t.serviceId, t.creator);
    }

    function _isAdministrator(address account) private view returns (bool) {
        return IAccessControl(address(organization)).hasRole(ADMINISTRATOR, account);
    }

    /// @dev How many bits are set.
    function _count(uint64 bits) private pure returns (uint8 count) {
        for (; bits != 0; bits &= bits - 1) {
            ++count;
        }
    }
}
