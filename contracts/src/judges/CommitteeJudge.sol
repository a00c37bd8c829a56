// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ECDSA} from "@openzeppelin/contracts/utils/cryptography/ECDSA.sol";
import {EIP712} from "@openzeppelin/contracts/utils/cryptography/EIP712.sol";
import {ICommitteeJudge, Quorum, Seat} from "../interfaces/ICommitteeJudge.sol";
import {Finding, IJudge} from "../interfaces/IJudge.sol";
import {IOrganization, MAX_CASE, MIN_WINDOW} from "../interfaces/IOrganization.sol";
import {Judged, Task} from "../interfaces/ITaskManager.sol";
import {KindId} from "../types/KindId.sol";
import {TaskId} from "../types/TaskId.sol";
import {Judge} from "./Judge.sol";

contract CommitteeJudge is ICommitteeJudge, Judge, EIP712 {
    /// @dev As many as Quorum.seats has bits.
    uint256 private constant MAX_JUDGES = 64;
    /// @dev Each day another judge is the first in line.
    uint256 private constant TURN = 1 days;
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
    /// @dev The same by number, in one word of which each ruling reads all that it needs.
    mapping(KindId number => Quorum) private _quorumNumbered;
    /// @dev The numbers of a kind whose quorum is written there.
    mapping(bytes32 kind => KindId[]) private _numbers;

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
        Quorum memory quorum = Quorum(votes, panel, rotation, count, seats);
        _quorums[kind] = quorum;
        KindId[] storage numbers = _numbers[kind];
        for (uint256 i = 0; i < numbers.length; ++i) {
            _quorumNumbered[numbers[i]] = quorum;
        }
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
        uint64 voters = _count(finding, a, _quorumFor(a.kindId), signatures);
        _remember(finding, voters);
        emit VotesCounted(finding.taskId, finding.rulesHash, voters);
    }

    /// @inheritdoc IJudge
    function termsFor(bytes32 kind) external view returns (bytes4, uint32, uint32) {
        _requireQuorum(kind);
        return (IJudge.termsFor.selector, MIN_WINDOW, MAX_CASE);
    }

    /// @inheritdoc ICommitteeJudge
    function votersOf(Finding calldata f, bytes calldata signatures) external view returns (uint64) {
        Task memory a = _case(f.taskId);
        // Nobody asks here whether a ruling stands.
        Judged memory judged = Judged(
            a.creator,
            _services.providerOf(a.serviceId),
            a.kindId,
            uint40(a.deadline - a.verdictWindow),
            false
        );
        return _count(f, judged, _requireQuorum(organization.kindNumbered(a.kindId)), signatures);
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

    /// @dev Who judges the kind with this number. It is looked up once by the kind, and then kept by its number.
    function _quorumFor(KindId number) private returns (Quorum memory quorum) {
        quorum = _quorumNumbered[number];
        if (quorum.votes != 0) return quorum;
        bytes32 kind = organization.kindNumbered(number);
        quorum = _requireQuorum(kind);
        _quorumNumbered[number] = quorum;
        _numbers[kind].push(number);
    }

    function _requireQuorum(bytes32 kind) private view returns (Quorum memory quorum) {
        quorum = _quorums[kind];
        if (quorum.votes == 0) revert KindWithoutQuorum(kind);
    }

    /// @dev The votes for a finding: of enough judges, each once, who may all judge the proof.
    function _count(Finding calldata f, Judged memory a, Quorum memory quorum, bytes calldata signatures)
        private
        view
        returns (uint64 voters)
    {
        if (signatures.length % SIGNATURE_BYTES != 0) revert InvalidSignatures(signatures.length);
        uint256 votes = signatures.length / SIGNATURE_BYTES;
        if (votes < quorum.votes) revert TooFewVotes(f.taskId, votes, quorum.votes);
        bytes32 digest = digestOf(f);
        address[] memory accounts = new address[](votes + votes);
        uint256 known = 0;
        for (uint256 i = 0; i < votes; ++i) {
            address key = _signer(digest, signatures[i * SIGNATURE_BYTES:]);
            (uint64 bit, address owner) = _requireJudge(f.taskId, a, quorum, key);
            if (voters & bit != 0) revert VotedTwice(f.taskId, key);
            voters |= bit;
            accounts[known++] = key;
            // The registry may know another owner than the seat.
            if (owner != key) accounts[known++] = owner;
        }
        assembly ("memory-safe") {
            mstore(accounts, known)
        }
        _requireMayJudge(f, a, accounts);
    }

    /// @dev Whose signature comes first; 0, which is no judge's, where it is nobody's. Refuses the second signature that
    /// anybody can compute from a first (EIP-2).
    function _signer(bytes32 digest, bytes calldata signatures) private pure returns (address key) {
        (bytes32 r, bytes32 vs) = abi.decode(signatures, (bytes32, bytes32));
        // slither-disable-next-line unused-return
        (key,,) = ECDSA.tryRecover(digest, r, vs);
    }

    /// @dev The bit of the judge with `key`, who may vote on the proof now.
    function _requireJudge(TaskId taskId, Judged memory a, Quorum memory quorum, address key)
        private
        view
        returns (uint64 bit, address owner)
    {
        Seat storage sitting = _seats[key];
        uint40 since;
        (owner, bit, since) = (sitting.owner, _bitOf(sitting.number), sitting.since);
        if (owner == address(0) || quorum.seats & bit == 0) {
            revert NotAJudge(key, organization.kindNumbered(a.kindId));
        }
        if (since >= a.submitted) revert KeyTooNew(taskId, key, since);
        if (quorum.panel < quorum.count) _requireInPanel(taskId, a.submitted, quorum, bit, key);
    }

    /// @dev The line begins with another judge each day, and the panel grows while judges are absent.
    /// @param bit of the judge's seat
    function _requireInPanel(TaskId taskId, uint256 submitted, Quorum memory quorum, uint64 bit, address key)
        private
        view
    {
        (uint256 panel, uint256 count) = (quorum.panel, quorum.count);
        if (quorum.rotation != 0) panel += (block.timestamp - submitted) / quorum.rotation;
        uint256 first = (submitted / TURN) % count;
        // Judges of the kind stand in line in order of their seats.
        uint256 place = (_bits(quorum.seats & (bit - 1)) + count - first) % count;
        if (place >= panel) revert NotInPanel(taskId, key, place, panel);
    }

    /// @dev Whether two of the seats have the same owner, as the seats or the registry say: its votes would count twice.
    function _sharesOwner(uint64 seats) private view returns (bool) {
        for (uint8 i = 0; seats >> i != 0; ++i) {
            if ((seats >> i) & 1 == 0) continue;
            address key = _keys[i];
            address owner = _seats[key].owner;
            uint64 before = seats & (_bitOf(i) - 1);
            if (includes(before, owner) || (key != owner && includes(before, key))) return true;
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
