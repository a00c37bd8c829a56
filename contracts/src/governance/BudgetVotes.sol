// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {IERC5805} from "@openzeppelin/contracts/interfaces/IERC5805.sol";
import {IOrganization} from "../interfaces/IOrganization.sol";
import {ADMINISTRATOR_ROLE} from "../types/Roles.sol";

/// @title Members split an amount of the treasury by quadratic votes: n votes for a recipient cost n² credits.
/// @notice Every identity has CREDITS credits in each round, so it has at most √CREDITS votes for one recipient. A
/// person with k identities has k times as many votes. The organization admits each identity, which bounds k. The
/// contract needs ALLOCATOR_ROLE. The administrator opens each round, so no budget limits it.
contract BudgetVotes {
    struct Round {
        uint96 amount;
        uint40 start;
        uint40 end;
        uint256 total;
        address[] recipients;
        uint256[] votes;
    }

    /// @notice Credits of one identity in one round.
    uint256 public constant CREDITS = 100;
    /// @dev Recipients of one round. A voter pays the gas of a loop over them.
    uint256 private constant MAX_RECIPIENTS = 16;

    IOrganization public immutable organization;
    /// @notice The contract MemberVotes, which knows the identities.
    IERC5805 public immutable members;
    Round[] private _rounds;
    mapping(uint256 roundId => mapping(address account => uint256[])) private _ballots;
    mapping(uint256 roundId => mapping(uint256 index => bool)) private _paid;

    event RoundOpened(uint256 indexed roundId, uint256 amount, uint256 end, address[] recipients);
    event BudgetVoteCast(uint256 indexed roundId, address indexed account, uint256[] votes);
    event BudgetPaid(uint256 indexed roundId, address indexed recipient, uint256 amount);

    error NotAdministrator(address account);
    error InvalidRound(uint256 recipients, uint256 max, uint256 duration);
    /// @notice Votes split between two entries would cost fewer credits.
    error RecipientTwice(address recipient);
    error UnknownRound(uint256 roundId);
    error NotAMember(address account);
    error RoundEnded(uint256 roundId, uint256 end);
    error RoundNotEnded(uint256 roundId, uint256 end);
    error InvalidBallot(uint256 votes, uint256 recipients);
    error TooFewCredits(address account, uint256 needed, uint256 credits);
    error PaidAlready(uint256 roundId, uint256 index);

    constructor(IOrganization organization_, IERC5805 members_) {
        (organization, members) = (organization_, members_);
    }

    /// @notice Open a round, in which the members split an amount among recipients. Administrator only.
    /// @param recipients the accounts that votes are for, each once
    /// @param amount in the token's smallest unit
    /// @param duration how long members may vote, s
    /// @return roundId the number of the round, counted from 0
    function open(address[] calldata recipients, uint96 amount, uint32 duration)
        external
        returns (uint256 roundId)
    {
        if (!IAccessControl(address(organization)).hasRole(ADMINISTRATOR_ROLE, msg.sender)) {
            revert NotAdministrator(msg.sender);
        }
        uint256 count = recipients.length;
        if (count == 0 || count > MAX_RECIPIENTS || duration == 0) {
            revert InvalidRound(count, MAX_RECIPIENTS, duration);
        }
        for (uint256 i = 0; i < count; ++i) {
            for (uint256 j = 0; j < i; ++j) {
                if (recipients[i] == recipients[j]) revert RecipientTwice(recipients[i]);
            }
        }
        roundId = _rounds.length;
        Round storage round = _rounds.push();
        (round.amount, round.recipients, round.votes) = (amount, recipients, new uint256[](count));
        (round.start, round.end) = (uint40(block.timestamp), uint40(block.timestamp + duration));
        emit RoundOpened(roundId, amount, round.end, recipients);
    }

    /// @notice Vote, or replace the caller's votes. The caller was a member before the round was opened.
    /// @param roundId a round that has not ended
    /// @param votes for each recipient; their squares add up to at most CREDITS
    function vote(uint256 roundId, uint256[] calldata votes) external {
        Round storage round = _get(roundId);
        if (block.timestamp >= round.end) revert RoundEnded(roundId, round.end);
        if (votes.length != round.votes.length) revert InvalidBallot(votes.length, round.votes.length);
        if (members.getPastVotes(msg.sender, round.start - 1) == 0) revert NotAMember(msg.sender);
        uint256[] memory before = _ballots[roundId][msg.sender];
        uint256 spent = 0;
        uint256 total = round.total;
        for (uint256 i = 0; i < votes.length; ++i) {
            // Before squaring, which could overflow.
            if (votes[i] > CREDITS) revert TooFewCredits(msg.sender, votes[i], CREDITS);
            spent += votes[i] * votes[i];
            uint256 old = before.length == 0 ? 0 : before[i];
            round.votes[i] = round.votes[i] + votes[i] - old;
            total = total + votes[i] - old;
        }
        if (spent > CREDITS) revert TooFewCredits(msg.sender, spent, CREDITS);
        round.total = total;
        _ballots[roundId][msg.sender] = votes;
        emit BudgetVoteCast(roundId, msg.sender, votes);
    }

    /// @notice Anybody has one recipient paid its share, once, after the end of the round. The remainder of the
    /// division stays in the treasury. So does the whole amount if nobody voted.
    /// @param roundId a round that has ended
    /// @param index the recipient's place in the list of the round
    function pay(uint256 roundId, uint256 index) external {
        Round storage round = _get(roundId);
        if (block.timestamp < round.end) revert RoundNotEnded(roundId, round.end);
        if (_paid[roundId][index]) revert PaidAlready(roundId, index);
        _paid[roundId][index] = true;
        address recipient = round.recipients[index];
        uint256 share = round.total == 0 ? 0 : round.amount * round.votes[index] / round.total;
        emit BudgetPaid(roundId, recipient, share);
        organization.payShare(recipient, share);
    }

    /// @notice Returns a round as it is now. Reverts with UnknownRound.
    function roundOf(uint256 roundId) external view returns (Round memory) {
        return _get(roundId);
    }

    function _get(uint256 roundId) private view returns (Round storage) {
        if (roundId >= _rounds.length) revert UnknownRound(roundId);
        return _rounds[roundId];
    }
}
