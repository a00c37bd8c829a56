// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {TaskId} from "../types/TaskId.sol";
import {Finding, IJudge} from "./IJudge.sol";

/// @param owner for whom the judge works; a party's judge does not judge
/// @param number the bit that stands for the seat in Quorum.seats; it stays when the key changes
/// @param since when this key came, block time in seconds. It counts for proofs that were submitted later
struct Seat {
    address owner;
    uint8 number;
    uint40 since;
}

/// @param votes how many equal votes make a ruling
/// @param panel how many judges may vote at once after the proof
/// @param rotation seconds after which one more may vote, the next in line; 0 for never
/// @param count how many bits `seats` has
/// @param seats one bit for each seat whose judge may judge the kind
struct Quorum {
    uint8 votes;
    uint8 panel;
    uint32 rotation;
    uint8 count;
    uint64 seats;
}

/// @title Judges of whom several have to agree.
/// @notice Judges sign what they find and send nothing; whoever holds enough signatures posts the ruling. The organization's
/// administrator seats the judges.
interface ICommitteeJudge is IJudge {
    event JudgeSeated(uint8 indexed seat, address indexed key, address indexed owner);
    event JudgeKeyChanged(uint8 indexed seat, address indexed oldKey, address indexed key);
    event QuorumChanged(bytes32 indexed kind, uint8 votes, uint8 panel, uint32 rotation, uint64 seats);
    /// @notice Follows the ruling, whose event ITaskManager.Ruled has the attempt.
    /// @param rules by which the judges say that they judged
    /// @param seats one bit for each seat that voted
    event VotesCounted(TaskId indexed taskId, bytes32 rules, uint64 seats);

    error InvalidSeat(address key, address owner);
    error AlreadySeated(address key);
    error TooManyJudges(uint256 max);
    /// @notice The key has not signed that it sits for this owner.
    error KeyNotProven(address key, address owner);
    /// @notice Nobody who signs with this key judges this kind. A signature on anything else gives such a key, too.
    error NotAJudge(address key, bytes32 kind);
    /// @notice The key came after the proof.
    error KeyTooNew(TaskId taskId, address key, uint256 since);
    /// @notice The votes of a kind are more than half of its panel, the panel has at most as many judges as the kind, and no
    /// two of them have the same owner.
    error InvalidQuorum(bytes32 kind, uint8 votes, uint8 panel, uint8 judges);
    error KindWithoutQuorum(bytes32 kind);
    error TooFewVotes(TaskId taskId, uint256 votes, uint256 needed);
    /// @notice 64 bytes each, as EIP-2098 has them.
    error InvalidSignatures(uint256 length);
    error VotedTwice(TaskId taskId, address key);
    /// @notice Not in the panel yet: `place` in line, while `panel` may vote.
    error NotInPanel(TaskId taskId, address key, uint256 place, uint256 panel);

    // -- administrator ------------------------------------------------------------------------------------

    /// @notice Give the next seat to a judge. It judges nothing before setQuorum names its seat, and no proof that was
    /// submitted before.
    /// @param key what it signs with
    /// @param owner for whom it works; itself, if for nobody
    /// @param r of the key's signature, see possessionOf
    /// @param vs of the key's signature (EIP-2098)
    /// @return number of the seat
    function seat(address key, address owner, bytes32 r, bytes32 vs) external returns (uint8 number);

    /// @notice Say who judges `kind` from now on, also what was submitted before.
    /// @param votes how many equal votes make a ruling, of all judges whom the panel has grown to
    /// @param panel how many may vote at once
    /// @param rotation seconds after which one more may vote, until all may; 0 for never
    /// @param seats one bit for each seat
    function setQuorum(bytes32 kind, uint8 votes, uint8 panel, uint32 rotation, uint64 seats) external;

    // -- a judge, or the administrator for it ---------------------------------------------------------------

    /// @notice The judge signs with another key from now on, for every kind. What the old one signed counts no more, and
    /// the new one counts for proofs that are submitted later.
    /// @param oldKey the key until now
    /// @param key the key from now on
    /// @param r of the new key's signature, see possessionOf
    /// @param vs of the new key's signature (EIP-2098)
    function changeKey(address oldKey, address key, bytes32 r, bytes32 vs) external;

    // -- anybody ------------------------------------------------------------------------------------------

    /// @notice Post the ruling that at least as many judges signed as the kind needs. No judge that is a party to the task
    /// may be among them, nor one whose owner is a party or owns one in the organization's registry.
    /// @param finding what they signed
    /// @param reportUri where the report lies; its hash is in the finding
    /// @param signatures of different judges in any order, 64 bytes each (EIP-2098)
    function postVotes(Finding calldata finding, string calldata reportUri, bytes calldata signatures)
        external;

    // -- views --------------------------------------------------------------------------------------------

    /// @notice Returns whose votes these are, one bit for each seat. Reverts unless enough judges, who may all judge the
    /// submitted proof, have signed the finding.
    /// @param finding what they signed
    /// @param signatures of different judges in any order, 64 bytes each (EIP-2098)
    function votersOf(Finding calldata finding, bytes calldata signatures) external view returns (uint64);

    /// @notice Returns the seat of the judge who signs with `key`; an owner of 0 where nobody does.
    /// @param key what it signs with
    function seatOf(address key) external view returns (Seat memory);

    /// @notice Returns whether one of these seats is `account`'s, by its key or its owner, as the seats and the organization's
    /// registry of devices know them.
    /// @param seats one bit for each seat
    function includes(uint64 seats, address account) external view returns (bool);

    /// @notice Returns the key of a seat; 0 where nobody sits.
    function keyOf(uint8 number) external view returns (address);

    /// @notice Returns who judges `kind`, and how many have to agree.
    function quorumOf(bytes32 kind) external view returns (Quorum memory);

    /// @notice Returns what a judge signs for `finding`: the EIP-712 digest, of this chain and this contract alone.
    /// @param finding what it says of a proof
    function digestOf(Finding calldata finding) external view returns (bytes32);

    /// @notice Returns what a key signs to sit for `owner`: the EIP-712 digest, of this chain and this contract alone.
    function possessionOf(address key, address owner) external view returns (bytes32);
}
