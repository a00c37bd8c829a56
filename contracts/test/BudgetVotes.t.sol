// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {IERC20Errors} from "@openzeppelin/contracts/interfaces/draft-IERC6093.sol";
import {IOrganization} from "../src/interfaces/IOrganization.sol";
import {BudgetVotes} from "../src/governance/BudgetVotes.sol";
import {MemberVotes} from "../src/governance/MemberVotes.sol";
import {ALLOCATOR_ROLE, MEMBER_ROLE, TREASURER_ROLE} from "../src/types/Roles.sol";
import {Fixture} from "./Fixture.sol";

/// @notice Members split money by quadratic votes; owners vote by what they have wrapped.
contract BudgetVotesTest is Fixture {
    MemberVotes private members;
    BudgetVotes private rounds;
    address[] private recipients = [makeAddr("repairs"), makeAddr("energy")];

    function setUp() public override {
        super.setUp();
        members = MemberVotes(deployed("MemberVotes", abi.encode(organization)));
        rounds = BudgetVotes(deployed("BudgetVotes", abi.encode(organization, members)));
        bytes32 role = ALLOCATOR_ROLE;
        vm.prank(admin);
        organization.grantRole(role, address(rounds));
        _admit(alice);
        _admit(bob);
        vm.warp(block.timestamp + 1);
    }

    function _admit(address account) private {
        vm.prank(admin);
        organization.grantRole(MEMBER_ROLE, account);
        members.sync(account);
    }

    function _open(uint96 amount) private returns (uint256 roundId) {
        vm.prank(admin);
        roundId = rounds.open(recipients, amount, 1 days);
    }

    function _vote(address who, uint256 roundId, uint256 first, uint256 second) private {
        uint256[] memory votes = new uint256[](2);
        (votes[0], votes[1]) = (first, second);
        vm.prank(who);
        rounds.vote(roundId, votes);
    }

    function test_theAmountIsSplitAsTheVotesAre() public {
        uint256 roundId = _open(100 ether);
        _vote(alice, roundId, 10, 0);
        // Changed before the end: only the last ballot counts.
        _vote(bob, roundId, 10, 0);
        _vote(bob, roundId, 6, 4);
        vm.warp(block.timestamp + 1 days);
        rounds.pay(roundId, 0);
        rounds.pay(roundId, 1);
        assertEq(coin.balanceOf(recipients[0]), 80 ether);
        assertEq(coin.balanceOf(recipients[1]), 20 ether);
        assertEq(coin.balanceOf(address(organization)), 1900 ether);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.PaidAlready.selector, roundId, 0));
        rounds.pay(roundId, 0);
    }

    /// @dev 2 votes for each of 16 entries would be 32 votes, of 64 credits.
    function test_nobodyIsInARoundTwice() public {
        recipients.push(recipients[0]);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.RecipientTwice.selector, recipients[0]));
        _open(100 ether);
    }

    /// @notice The Sybil bound: one identity moves at most √CREDITS votes, k admitted ones k times as many, and accounts
    /// that nobody admitted, or too late, none.
    function test_votesGrowWithIdentitiesAndNotWithMoney() public {
        uint256 credits = rounds.CREDITS();
        uint256 roundId = _open(100 ether);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.TooFewCredits.selector, alice, 121, credits));
        _vote(alice, roundId, 11, 0);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.TooFewCredits.selector, alice, 101, credits));
        _vote(alice, roundId, 10, 1);
        vm.expectRevert(
            abi.encodeWithSelector(BudgetVotes.TooFewCredits.selector, alice, type(uint256).max, credits)
        );
        _vote(alice, roundId, type(uint256).max, 0);
        _admit(robot1);
        vm.warp(block.timestamp + 1);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.NotAMember.selector, robot1));
        _vote(robot1, roundId, 1, 0);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.NotAMember.selector, stranger));
        _vote(stranger, roundId, 1, 0);

        address[5] memory sybils;
        for (uint160 i = 0; i < 5; ++i) {
            sybils[i] = address((i + 1) << 96);
            _admit(sybils[i]);
        }
        vm.warp(block.timestamp + 1);
        roundId = _open(100 ether);
        for (uint256 i = 0; i < 5; ++i) {
            _vote(sybils[i], roundId, 0, 10);
        }
        assertEq(rounds.roundOf(roundId).votes[1], 5 * 10);
    }

    function test_votesAreTakenUntilTheEndAndPaidAfterIt() public {
        uint256 roundId = _open(100 ether);
        uint256 end = block.timestamp + 1 days;
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.RoundNotEnded.selector, roundId, end));
        rounds.pay(roundId, 0);
        vm.warp(end);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.RoundEnded.selector, roundId, end));
        _vote(alice, roundId, 1, 1);
        // Nobody voted: nothing is paid.
        rounds.pay(roundId, 0);
        assertEq(coin.balanceOf(recipients[0]), 0);
    }

    /// @dev As its votes on proposals do. Who is admitted again has the ballot that it had.
    function test_whoWasDismissedVotesNoMoreAndWhatItGaveStays() public {
        uint256 roundId = _open(100 ether);
        _vote(alice, roundId, 10, 0);
        _vote(bob, roundId, 0, 10);
        vm.prank(admin);
        organization.revokeRole(MEMBER_ROLE, bob);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.NotAMember.selector, bob));
        _vote(bob, roundId, 10, 0);
        assertEq(rounds.roundOf(roundId).votes[1], 10);
        _admit(bob);
        _vote(bob, roundId, 0, 5);
        assertEq(rounds.roundOf(roundId).votes[1], 5);
        assertEq(rounds.roundOf(roundId).total, 15);
    }

    function test_aShareThatCannotBePaidStaysDueAndKeepsNobodyElseWaiting() public {
        uint256 treasury = coin.balanceOf(address(organization));
        uint256 roundId = _open(uint96(treasury));
        _vote(alice, roundId, 9, 1);
        vm.warp(block.timestamp + 1 days);
        vm.prank(admin);
        organization.withdraw(admin, treasury / 2);
        vm.expectPartialRevert(IERC20Errors.ERC20InsufficientBalance.selector);
        rounds.pay(roundId, 0);
        rounds.pay(roundId, 1);
        assertEq(coin.balanceOf(recipients[1]), treasury / 10);
        vm.startPrank(admin);
        coin.approve(address(organization), treasury);
        organization.deposit(treasury / 2);
        vm.stopPrank();
        rounds.pay(roundId, 0);
        assertEq(coin.balanceOf(recipients[0]), treasury / 10 * 9);
    }

    function test_sharesUseUpNoBudgetAndTreasurersKeepTheirs() public {
        bytes32 role = TREASURER_ROLE;
        vm.prank(admin);
        organization.setBudget(role, 10 ether, 1 days);
        uint256 roundId = _open(100 ether);
        _vote(alice, roundId, 10, 0);
        vm.warp(block.timestamp + 1 days);
        vm.prank(admin);
        organization.withdraw(admin, 10 ether);
        rounds.pay(roundId, 0);
        assertEq(coin.balanceOf(recipients[0]), 100 ether);
        assertEq(organization.budgetOf(role).spent, 10 ether);
        vm.expectPartialRevert(IOrganization.OverBudget.selector);
        vm.prank(admin);
        organization.withdraw(admin, 1);
    }

    function test_noKeyPaysShares() public {
        bytes32 role = ALLOCATOR_ROLE;
        vm.startPrank(admin);
        vm.expectRevert(abi.encodeWithSelector(IOrganization.NotAContract.selector, alice));
        organization.grantRole(role, alice);
        // A key to which EIP-7702 has given the code of a contract.
        vm.etch(bob, abi.encodePacked(hex"ef0100", address(rounds)));
        vm.expectRevert(abi.encodeWithSelector(IOrganization.NotAContract.selector, bob));
        organization.grantRole(role, bob);
        vm.expectRevert(
            abi.encodeWithSelector(IAccessControl.AccessControlUnauthorizedAccount.selector, admin, role)
        );
        organization.payShare(admin, 1);
        vm.stopPrank();
    }

    function test_withoutTheRoleOfAllocatorsNobodyIsPaid() public {
        uint256 roundId = _open(100 ether);
        _vote(alice, roundId, 10, 0);
        vm.warp(block.timestamp + 1 days);
        bytes32 role = ALLOCATOR_ROLE;
        vm.prank(admin);
        organization.revokeRole(role, address(rounds));
        vm.expectRevert(
            abi.encodeWithSelector(
                IAccessControl.AccessControlUnauthorizedAccount.selector, address(rounds), role
            )
        );
        rounds.pay(roundId, 0);
        assertEq(coin.balanceOf(recipients[0]), 0);
    }

    function test_roundsThatCannotBeAreRefused() public {
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.NotAdministrator.selector, alice));
        vm.prank(alice);
        rounds.open(recipients, 1, 1);
        vm.startPrank(admin);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.InvalidRound.selector, 0, 16, 1));
        rounds.open(new address[](0), 1, 1);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.InvalidRound.selector, 17, 16, 1));
        rounds.open(new address[](17), 1, 1);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.InvalidRound.selector, 2, 16, 0));
        rounds.open(recipients, 1, 0);
        vm.stopPrank();
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.UnknownRound.selector, 0));
        rounds.pay(0, 0);
        uint256 roundId = _open(1);
        vm.expectRevert(abi.encodeWithSelector(BudgetVotes.InvalidBallot.selector, 1, 2));
        vm.prank(alice);
        rounds.vote(roundId, new uint256[](1));
    }
}
