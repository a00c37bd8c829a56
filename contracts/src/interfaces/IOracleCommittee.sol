// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {TaskId} from "../types/TaskId.sol";
import {IOrganization} from "./IOrganization.sol";
import {ITaskManager, Vote} from "./ITaskManager.sol";

/// @param owner for whom the judge works; a party's judge does not judge
/// @param seat the bit that stands for it in Quorum.judges; it stays when the key changes
struct Judge {
    address owner;
    uint8 seat;
}

/// @param votes how many equal votes make a verdict
/// @param panel how many judges may vote at once after the proof
/// @param rotation seconds after which one more may vote, the next in line; 0 for never
/// @param count how many bits `judges` has
/// @param judges one bit for each seat whose judge may judge the kind
struct Quorum {
    uint8 votes;
    uint8 panel;
    uint32 rotation;
    uint8 count;
    uint64 judges;
}

/// @title Judges of whom several have to agree.
/// @notice The organization gives ORACLE_ROLE to this contract, and to no single key. Judges sign votes and send
/// nothing; whoever holds enough of them posts the verdict. The organization's administrator seats the judges.
interface IOracleCommittee {
    event JudgeSeated(uint8 indexed seat, address indexed key, address indexed owner);
    event JudgeKeyChanged(uint8 indexed seat, address indexed oldKey, address indexed key);
    event QuorumChanged(bytes32 indexed kind, uint8 votes, uint8 panel, uint32 rotation, uint64 judges);
    /// @param rules by which the judges say that they judged
    /// @param judges one bit for each seat that voted
    event VotesCounted(TaskId indexed taskId, uint8 attempt, bytes32 rules, uint64 judges);

    error NotAdministrator(address account);
    error InvalidJudge(address key, address owner);
    error AlreadySeated(address key);
    error TooManyJudges(uint256 max);
    /// @notice Nobody who signs with this key judges this kind. A signature on anything else gives such a key, too.
    error NotAJudge(address key, bytes32 kind);
    /// @notice The votes of a kind are more than half of its panel, and the panel has at most as many judges as the
    /// kind.
    error InvalidQuorum(bytes32 kind, uint8 votes, uint8 panel, uint8 judges);
    error KindWithoutQuorum(bytes32 kind);
    error TooFewVotes(TaskId taskId, uint256 votes, uint256 needed);
    /// @notice 64 bytes each, as EIP-2098 has them.
    error InvalidSignatures(uint256 length);
    error VotedTwice(TaskId taskId, address key);
    /// @notice Not in the panel yet: `place` in line, while `panel` may vote.
    error NotInPanel(TaskId taskId, address key, uint256 place, uint256 panel);
    /// @notice An auditor would decide alone what it had left undecided with others.
    error JudgeIsAuditor(TaskId taskId, address key);

    // -- administrator ------------------------------------------------------------------------------------

    /// @notice Give the next seat to a judge. It judges nothing before setQuorum names its seat.
    /// @param key what it signs with
    /// @param owner for whom it works; itself, if for nobody
    function seat(address key, address owner) external returns (uint8 seatNumber);

    /// @notice Say who judges `kind` from now on, also what was submitted before.
    /// @param kind what is to be done, ASCII
    /// @param votes how many equal votes make a verdict, of all judges whom the panel has grown to
    /// @param panel how many may vote at once
    /// @param rotation seconds after which one more may vote, until all may; 0 for never
    /// @param judges one bit for each seat
    function setQuorum(bytes32 kind, uint8 votes, uint8 panel, uint32 rotation, uint64 judges) external;

    // -- a judge, or the administrator for it ---------------------------------------------------------------

    /// @notice The judge signs with another key from now on, for every kind. What the old one signed counts no more.
    /// @param oldKey the key until now
    /// @param key the key from now on
    function changeKey(address oldKey, address key) external;

    // -- anybody ------------------------------------------------------------------------------------------

    /// @notice Post the verdict that at least as many judges signed as the kind needs. No judge that is a party to
    /// the task may be among them, nor one whose owner is a party or owns one in the organization's registry.
    /// @param vote what they signed
    /// @param reportUri where the report lies; its hash is in the vote
    /// @param signatures of different judges in any order, 64 bytes each (EIP-2098)
    function postVotes(Vote calldata vote, string calldata reportUri, bytes calldata signatures) external;

    // -- a contract that may judge the kind -----------------------------------------------------------------

    /// @notice Say whose votes these are. Reverts unless enough judges, who may all judge the submitted proof, have signed
    /// the verdict.
    /// @param vote the verdict
    /// @param signatures of different judges in any order, 64 bytes each (EIP-2098)
    /// @return voters one bit for each seat that voted
    function countVoters(Vote calldata vote, bytes calldata signatures) external returns (uint64 voters);

    // -- views --------------------------------------------------------------------------------------------

    function organization() external view returns (IOrganization);
    function tasks() external view returns (ITaskManager);

    /// @notice The judge who signs with `key`; an owner of 0 where nobody does.
    /// @param key what it signs with
    function judge(address key) external view returns (Judge memory);

    /// @notice The key of a seat; 0 where nobody sits.
    /// @param seatNumber see seat
    function keyOf(uint8 seatNumber) external view returns (address);

    /// @notice Who judges `kind`, and how many have to agree.
    /// @param kind what is to be done, ASCII
    function quorumOf(bytes32 kind) external view returns (Quorum memory);

    /// @notice What a judge signs for `vote`: the EIP-712 digest, of this chain and this contract alone.
    /// @param vote what it says of a proof
    function digestOf(Vote calldata vote) external view returns (bytes32);
}
