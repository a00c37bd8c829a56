// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {CommonBase} from "forge-std/Base.sol";
import {StdUtils} from "forge-std/StdUtils.sol";
import {Organization} from "../../src/Organization.sol";
import {BudgetVotes} from "../../src/governance/BudgetVotes.sol";
import {MemberVotes} from "../../src/governance/MemberVotes.sol";
import {ALLOCATOR_ROLE, MEMBER_ROLE} from "../../src/types/Roles.sol";
import {Fixture} from "../Fixture.sol";

/// @notice Members come and go, and split the treasury; everybody tries what is not allowed.
contract VotersHandler is CommonBase, StdUtils {
    /// @dev What the votes learned about an account, and when.
    struct Told {
        uint256 time;
        bool member;
    }

    uint256 public constant ACCOUNTS = 4;
    uint256 public constant RECIPIENTS = 2;

    Organization private immutable _organization;
    MemberVotes private immutable _members;
    BudgetVotes private immutable _rounds;
    address private immutable _admin;
    mapping(address account => Told[]) private _told;
    mapping(uint256 roundId => mapping(uint256 who => uint256[RECIPIENTS])) private _ballots;
    mapping(uint256 roundId => mapping(uint256 index => bool)) private _paid;

    uint256 public roundCount;
    /// @notice What recipients got by the rules.
    uint256 public expectedPaid;
    /// @notice What the rules forbid and happened nevertheless; empty if nothing did.
    string public violation;

    constructor(Organization organization, MemberVotes members, BudgetVotes rounds, address admin) {
        (_organization, _members, _rounds, _admin) = (organization, members, rounds, admin);
    }

    function account(uint256 which) public pure returns (address) {
        return address(uint160(which % ACCOUNTS + 1) << 96);
    }

    function recipient(uint256 which) public pure returns (address) {
        return address(uint160(which % RECIPIENTS + 101) << 96);
    }

    function admit(uint256 which) external {
        vm.prank(_admin);
        _organization.grantRole(MEMBER_ROLE, account(which));
        sync(which);
    }

    /// @dev Every other one is reported to the votes at once.
    function dismiss(uint256 which, bool told) external {
        vm.prank(_admin);
        _organization.revokeRole(MEMBER_ROLE, account(which));
        if (told) sync(which);
    }

    function sync(uint256 which) public {
        address who = account(which);
        _members.sync(who);
        _told[who].push(Told(block.timestamp, _organization.isMember(who)));
    }

    function delegate(uint256 from, uint256 to) external {
        vm.prank(account(from));
        try _members.delegate(account(to)) {
            violation = "a vote was delegated";
        } catch {}
    }

    function open(uint256 amount, bool administrator, uint256 who) external {
        address[] memory recipients = new address[](RECIPIENTS);
        for (uint256 i = 0; i < RECIPIENTS; ++i) {
            recipients[i] = recipient(i);
        }
        amount = bound(amount, 0, 10 ether);
        vm.prank(administrator ? _admin : account(who));
        try _rounds.open(recipients, uint96(amount), 1 hours) {
            if (!administrator) violation = "somebody else split the treasury";
            ++roundCount;
        } catch {
            if (administrator) violation = "the administrator could not open a round";
        }
    }

    function vote(uint256 which, uint256 roundId, uint256 first, uint256 second) external {
        if (roundCount == 0) return;
        // The newest are open.
        roundId = roundCount - 1 - roundId % _min(roundCount, 3);
        uint256[] memory votes = new uint256[](RECIPIENTS);
        (votes[0], votes[1]) = (first % 12, second % 12);
        BudgetVotes.Round memory round = _rounds.roundOf(roundId);
        address who = account(which);
        bool right = block.timestamp < round.end && votes[0] ** 2 + votes[1] ** 2 <= 100
            && _organization.isMember(who) && _wasMember(who, round.start);
        vm.prank(who);
        try _rounds.vote(roundId, votes) {
            if (!right) violation = "a ballot counted that should not";
            _ballots[roundId][which % ACCOUNTS] = [votes[0], votes[1]];
        } catch {
            if (right) violation = "a member could not vote";
        }
    }

    function pay(uint256 roundId, uint256 index) external {
        if (roundCount == 0) return;
        (roundId, index) = (roundId % roundCount, index % RECIPIENTS);
        BudgetVotes.Round memory round = _rounds.roundOf(roundId);
        bool right = block.timestamp >= round.end && !_paid[roundId][index];
        try _rounds.pay(roundId, index) {
            if (!right) violation = "a recipient was paid twice, or before the end";
            _paid[roundId][index] = true;
            uint256 total = expectedVotes(roundId, 0) + expectedVotes(roundId, 1);
            if (total != 0) expectedPaid += round.amount * expectedVotes(roundId, index) / total;
        } catch {
            if (right) violation = "a recipient could not be paid";
        }
    }

    function wait(uint256 time) external {
        vm.warp(block.timestamp + bound(time, 1, 40 minutes));
    }

    /// @notice What the last ballots of all accounts add up to.
    function expectedVotes(uint256 roundId, uint256 index) public view returns (uint256 sum) {
        for (uint256 i = 0; i < ACCOUNTS; ++i) {
            sum += _ballots[roundId][i][index];
        }
    }

    /// @dev Before `time`, as the votes knew.
    function _wasMember(address who, uint256 time) private view returns (bool was) {
        for (uint256 i = 0; i < _told[who].length && _told[who][i].time < time; ++i) {
            was = _told[who][i].member;
        }
    }

    function _min(uint256 a, uint256 b) private pure returns (uint256) {
        return a < b ? a : b;
    }
}

contract GovernanceInvariants is Fixture {
    MemberVotes private _members;
    BudgetVotes private _rounds;
    VotersHandler private _handler;

    function setUp() public override {
        super.setUp();
        _members = MemberVotes(deployed("MemberVotes", abi.encode(organization)));
        _rounds = BudgetVotes(deployed("BudgetVotes", abi.encode(organization, _members)));
        bytes32 role = ALLOCATOR_ROLE;
        vm.prank(admin);
        organization.grantRole(role, address(_rounds));
        _handler = new VotersHandler(organization, _members, _rounds, admin);
        targetContract(address(_handler));
    }

    /// @notice What holds after each call. One campaign asks for all of it: others would make the same calls again.
    function invariant_everythingHolds() public view {
        _anIdentityHasOneVote();
        _votesAreTheLastBallots();
        _theTreasuryIsSplitByVotesAlone();
    }

    /// @dev An identity has one vote or none, and whoever is no member has none.
    function _anIdentityHasOneVote() private view {
        for (uint256 i = 0; i < _handler.ACCOUNTS(); ++i) {
            address account = _handler.account(i);
            uint256 votes = _members.getPastVotes(account, block.timestamp - 1);
            assertLe(_members.getVotes(account), 1);
            assertLe(votes, organization.isMember(account) ? 1 : 0);
        }
    }

    /// @dev Each identity's last ballot counts once, and none is larger than its credits.
    function _votesAreTheLastBallots() private view {
        for (uint256 roundId = 0; roundId < _handler.roundCount(); ++roundId) {
            BudgetVotes.Round memory round = _rounds.roundOf(roundId);
            assertEq(round.votes[0], _handler.expectedVotes(roundId, 0));
            assertEq(round.votes[1], _handler.expectedVotes(roundId, 1));
            assertEq(round.total, round.votes[0] + round.votes[1]);
        }
    }

    /// @dev The treasury loses what the votes say, and nothing forbidden happened.
    function _theTreasuryIsSplitByVotesAlone() private view {
        assertEq(_handler.violation(), "");
        uint256 paid = 0;
        for (uint256 i = 0; i < _handler.RECIPIENTS(); ++i) {
            paid += coin.balanceOf(_handler.recipient(i));
        }
        assertEq(paid, _handler.expectedPaid());
        assertEq(coin.balanceOf(address(organization)), 2000 ether - paid);
    }
}
