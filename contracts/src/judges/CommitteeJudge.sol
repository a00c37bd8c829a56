// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ECDSA} from "@openzeppelin/contracts/utils/cryptography/ECDSA.sol";
import {EIP712} from "@openzeppelin/contracts/utils/cryptography/EIP712.sol";
import {ICommitteeJudge, Quorum, Seat} from "../interfaces/ICommitteeJudge.sol";
import {Finding, IJudge} from "../interfaces/IJudge.sol";
import {IOrganization} from "../interfaces/IOrganization.sol";
import {Judged, Task} from "../interfaces/ITaskManager.sol";
import {KindId} from "../types/KindId.sol";
import {TaskId} from "../types/TaskId.sol";
import {Judge} from "./Judge.sol";

contract CommitteeJudge is ICommitteeJudge, Judge, EIP712 {
    /// @dev The votes on a proof have to fit this. All of it is read once, whatever the number of votes.
    struct Question {
        bytes32 kind;
        Judged attempt;
        Quorum quorum;
    }

    /// @notice As many as Quorum.seats has bits.
    uint256 public constant MAX_JUDGES = 64;
    /// @notice Each day another judge is the first in line.
    uint256 public constant TURN = 1 days;
    /// @notice The shortest time for a ruling: recordings are fetched, and signatures collected.
    uint32 public constant MIN_VERDICT_WINDOW = 1 minutes;
    uint32 public constant MAX_CASE = 30 days;

    /// @dev r, and s with its parity: EIP-2098.
    uint256 private constant SIGNATURE_BYTES = 64;
    bytes32 private constant POSSESSION_TYPEHASH = keccak256("Possession(address key,address owner)");
    bytes32 private constant FINDING_TYPEHASH = keccak256(
        "Finding(uint256 taskId,uint8 attempt,bytes32 proofHash,bytes32 reportHash,bytes32 rulesHash,"
        "uint8 ruling,uint8 fault,uint96 amount,string reason)"
    );

    address[] private _keys;
    mapping(address key => Seat) private _seats;
    /// @dev By kind and not by its number, because the organization asks for the terms before there is a number.
    mapping(bytes32 kind => Quorum) private _quorums;
    mapping(KindId number => bytes32) private _kinds;

    constructor(IOrganization organization_, address next_)
        Judge(organization_, next_)
        EIP712("RODEO CommitteeJudge", "1")
    {}

    /// @inheritdoc ICommitteeJudge
    function seat(address key, address owner, bytes32 r, bytes32 vs)
        external
        onlyAdministrator
        returns (uint8 number)
    {
        if (key == address(0) || owner == address(0)) revert InvalidSeat(key, owner);
        if (_keys.length == MAX_JUDGES) revert TooManyJudges(MAX_JUDGES);
        number = uint8(_keys.length);
        _keys.push(key);
        _sit(key, owner, number, r, vs);
        emit JudgeSeated(number, key, owner);
    }

    /// @inheritdoc ICommitteeJudge
    function setQuorum(bytes32 kind, uint8 votes, uint8 panel, uint32 rotation, uint64 seats)
        external
        onlyAdministrator
    {
        uint8 count = _bits(seats);
        bool seated = _keys.length == MAX_JUDGES || seats >> _keys.length == 0;
        // More than half, so that two rulings on one proof need a judge who votes for both. With a rotation that holds
        // only while the panel is that small: it grows to all judges, of whom two groups may then have enough votes.
        bool enough = uint256(votes) * 2 > panel && votes <= panel && panel <= count;
        if (!seated || !enough || _sharesOwner(seats)) revert InvalidQuorum(kind, votes, panel, count);
        _quorums[kind] = Quorum(votes, panel, rotation, count, seats);
        emit QuorumChanged(kind, votes, panel, rotation, seats);
    }

    /// @inheritdoc ICommitteeJudge
    function changeKey(address oldKey, address key, bytes32 r, bytes32 vs) external {
        if (msg.sender != oldKey) _requireAdministrator();
        Seat memory sitting = _seats[oldKey];
        if (sitting.owner == address(0) || key == address(0)) revert InvalidSeat(oldKey, sitting.owner);
        _sit(key, sitting.owner, sitting.number, r, vs);
        delete _seats[oldKey];
        _keys[sitting.number] = key;
        emit JudgeKeyChanged(sitting.number, oldKey, key);
    }

    /// @inheritdoc ICommitteeJudge
    function postVotes(Finding calldata finding, string calldata reportUri, bytes calldata signatures)
        external
    {
        Judged memory a = _find(finding, reportUri, 0);
        uint64 voters = _count(finding, _question(_kindOf(a.kindId), a), signatures);
        _remember(finding, voters);
        emit VotesCounted(finding.taskId, finding.attempt, finding.rulesHash, voters);
    }

    /// @inheritdoc IJudge
    function termsFor(bytes32 kind) external view returns (bytes4, uint32, uint32) {
        if (_quorums[kind].votes == 0) revert KindWithoutQuorum(kind);
        return (IJudge.termsFor.selector, MIN_VERDICT_WINDOW, MAX_CASE);
    }

    /// @inheritdoc ICommitteeJudge
    function votersOf(Finding calldata f, bytes calldata signatures) external view returns (uint64) {
        Task memory a = _case(f.taskId);
        // Nobody asks here whether a ruling stands.
        Judged memory judged =
            Judged(a.creator, a.serviceId, a.kindId, uint40(a.deadline - a.verdictWindow), false);
        return _count(f, _question(organization.kindNumbered(a.kindId), judged), signatures);
    }

    /// @inheritdoc ICommitteeJudge
    function seatOf(address key) external view returns (Seat memory) {
        return _seats[key];
    }

    /// @inheritdoc ICommitteeJudge
    function includes(uint64 seats, address account) public view returns (bool) {
        for (uint8 i = 0; seats >> i != 0; ++i) {
            if ((seats >> i) & 1 == 0) continue;
            address key = _keys[i];
            address owner = _seats[key].owner;
            if (_providers.areRelated(account, owner)) return true;
            if (key != owner && _providers.areRelated(account, key)) return true;
        }
        return false;
    }

    /// @inheritdoc ICommitteeJudge
    function keyOf(uint8 number) external view returns (address) {
        return number < _keys.length ? _keys[number] : address(0);
    }

    /// @inheritdoc ICommitteeJudge
    function quorumOf(bytes32 kind) external view returns (Quorum memory) {
        return _quorums[kind];
    }

    /// @inheritdoc ICommitteeJudge
    function digestOf(Finding calldata f) public view returns (bytes32) {
        return _hashTypedDataV4(
            keccak256(
                abi.encode(
                    FINDING_TYPEHASH,
                    f.taskId,
                    f.attempt,
                    f.proofHash,
                    f.reportHash,
                    f.rulesHash,
                    f.ruling,
                    f.fault,
                    f.amount,
                    keccak256(bytes(f.reason))
                )
            )
        );
    }

    /// @inheritdoc ICommitteeJudge
    function possessionOf(address key, address owner) public view returns (bytes32) {
        return _hashTypedDataV4(keccak256(abi.encode(POSSESSION_TYPEHASH, key, owner)));
    }

    /// @inheritdoc Judge
    function _isAmong(uint248 by, address account) internal view override returns (bool) {
        return includes(uint64(by), account);
    }

    /// @dev The key sits from now on; it has signed that it wants to.
    function _sit(address key, address owner, uint8 number, bytes32 r, bytes32 vs) private {
        if (_seats[key].owner != address(0)) revert AlreadySeated(key);
        // slither-disable-next-line unused-return
        (address signer,,) = ECDSA.tryRecover(possessionOf(key, owner), r, vs);
        if (signer != key) revert KeyNotProven(key, owner);
        _seats[key] = Seat(owner, number, uint40(block.timestamp));
    }

    /// @dev As the organization numbers it, which never changes: asked once for each number.
    function _kindOf(KindId number) private returns (bytes32 kind) {
        kind = _kinds[number];
        if (kind == 0) _kinds[number] = kind = organization.kindNumbered(number);
    }

    function _question(bytes32 kind, Judged memory a) private view returns (Question memory) {
        Quorum memory quorum = _quorums[kind];
        if (quorum.votes == 0) revert KindWithoutQuorum(kind);
        return Question(kind, a, quorum);
    }

    /// @dev The votes for a finding: of enough judges, each once, who may all judge the proof.
    function _count(Finding calldata f, Question memory q, bytes calldata signatures)
        private
        view
        returns (uint64 voters)
    {
        if (signatures.length % SIGNATURE_BYTES != 0) revert InvalidSignatures(signatures.length);
        uint256 votes = signatures.length / SIGNATURE_BYTES;
        if (votes < q.quorum.votes) revert TooFewVotes(f.taskId, votes, q.quorum.votes);
        bytes32 digest = digestOf(f);
        // The registry may know another owner than the seat.
        address[] memory accounts = new address[](votes + votes);
        for (uint256 i = 0; i < votes; ++i) {
            (bytes32 r, bytes32 vs) = abi.decode(signatures[i * SIGNATURE_BYTES:], (bytes32, bytes32));
            // Refuses the second signature that anybody can compute from a first. See EIP-2. Where it fails the
            // key is 0, which is no judge's.
            // slither-disable-next-line unused-return
            (address key,,) = ECDSA.tryRecover(digest, r, vs);
            (uint64 bit, address owner) = _requireJudge(f.taskId, q, key);
            if (voters & bit != 0) revert VotedTwice(f.taskId, key);
            voters |= bit;
            (accounts[2 * i], accounts[2 * i + 1]) = (key, owner);
        }
        _requireNoParty(f.taskId, q.attempt.serviceId, q.attempt.creator, accounts);
    }

    /// @dev The bit of the judge with `key`, who may vote on the proof now.
    function _requireJudge(TaskId taskId, Question memory q, address key)
        private
        view
        returns (uint64 bit, address owner)
    {
        Seat memory sitting = _seats[key];
        bit = _bitOf(sitting.number);
        owner = sitting.owner;
        if (owner == address(0) || q.quorum.seats & bit == 0) revert NotAJudge(key, q.kind);
        if (sitting.since >= q.attempt.submitted) revert KeyTooNew(taskId, key, sitting.since);
        if (q.quorum.panel < q.quorum.count) _requireInPanel(taskId, q, bit, key);
    }

    /// @dev The line begins with another judge each day, and the panel grows while judges are absent.
    /// @param bit of the judge's seat
    function _requireInPanel(TaskId taskId, Question memory q, uint64 bit, address key) private view {
        (uint256 submitted, uint256 panel, uint256 count) =
            (q.attempt.submitted, q.quorum.panel, q.quorum.count);
        if (q.quorum.rotation != 0) panel += (block.timestamp - submitted) / q.quorum.rotation;
        uint256 first = (submitted / TURN) % count;
        // Judges of the kind stand in line in order of their seats.
        uint256 place = (_bits(q.quorum.seats & (bit - 1)) + count - first) % count;
        if (place >= panel) revert NotInPanel(taskId, key, place, panel);
    }

    /// @dev Whether two of the seats have the same owner: its votes would count twice.
    function _sharesOwner(uint64 seats) private view returns (bool) {
        address[] memory owners = new address[](_keys.length);
        for (uint256 i = 0; i < owners.length; ++i) {
            if ((seats >> i) & 1 == 0) continue;
            owners[i] = _seats[_keys[i]].owner;
            for (uint256 j = 0; j < i; ++j) {
                if (owners[j] == owners[i]) return true;
            }
        }
        return false;
    }

    /// @dev The bit of a seat in Quorum.seats.
    function _bitOf(uint8 number) private pure returns (uint64) {
        return uint64(1 << number);
    }

    /// @dev How many bits are set.
    function _bits(uint64 bits) private pure returns (uint8 count) {
        for (; bits != 0; bits &= bits - 1) {
            ++count;
        }
    }
}
