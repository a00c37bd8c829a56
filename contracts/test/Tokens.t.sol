// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ERC20} from "@openzeppelin/contracts/token/ERC20/ERC20.sol";
import {SafeERC20} from "@openzeppelin/contracts/token/ERC20/utils/SafeERC20.sol";
import {ReentrancyGuardTransient} from "@openzeppelin/contracts/utils/ReentrancyGuardTransient.sol";
import {IOrganization} from "../src/interfaces/IOrganization.sol";
import {ServiceState} from "../src/interfaces/IServiceManager.sol";
import {Fault, ITaskManager, TaskState, Ruling} from "../src/interfaces/ITaskManager.sol";
import {Finding} from "../src/interfaces/IJudge.sol";
import {NO_SERVICE, ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";

/// @notice A token that misbehaves as the test says.
contract WeirdToken is ERC20("Weird", "WRD") {
    enum Way {
        Well,
        ReturnsFalse,
        Reverts,
        TakesAFee,
        MovesNothing,
        BurnsGas,
        MovesAndReturnsFalse,
        MovesHalfAndReturnsFalse
    }

    error Refused();

    Way private _way;
    address private _victim;
    address private _target;
    bytes private _reentry;
    bytes public answer;
    bool public entered;

    /// @dev What happens to transfers from or to `victim`; to all where it is 0.
    function behave(Way way, address victim) external {
        (_way, _victim) = (way, victim);
    }

    /// @dev Call `target` back in the middle of the next transfer.
    function reenter(address target, bytes calldata data) external {
        (_target, _reentry) = (target, data);
    }

    function mint(address to, uint256 amount) external {
        _mint(to, amount);
    }

    /// @dev For its second address.
    function move(address from, address to, uint256 amount) external {
        _transfer(from, to, amount);
    }

    function transfer(address to, uint256 amount) public override returns (bool) {
        return _weird(msg.sender, to, amount, false);
    }

    function transferFrom(address from, address to, uint256 amount) public override returns (bool) {
        return _weird(from, to, amount, true);
    }

    function _weird(address from, address to, uint256 amount, bool spend) private returns (bool) {
        if (_target != address(0)) {
            address target = _target;
            _target = address(0);
            (entered, answer) = target.call(_reentry);
        }
        if (_way != Way.Well && (_victim == address(0) || _victim == from || _victim == to)) {
            if (_way == Way.ReturnsFalse) return false;
            if (_way == Way.Reverts) revert Refused();
            while (_way == Way.BurnsGas) {}
            if (_way == Way.MovesNothing) return true;
            if (_way == Way.MovesHalfAndReturnsFalse) amount /= 2;
            if (_way >= Way.MovesAndReturnsFalse) {
                _transfer(from, to, amount);
                return false;
            }
            // A hundredth is lost on the way.
            _burn(from, amount / 100);
            amount -= amount / 100;
        }
        if (spend) _spendAllowance(from, msg.sender, amount);
        _transfer(from, to, amount);
        return true;
    }
}

/// @notice The same token under another address.
contract SecondAddress {
    WeirdToken private immutable _token;

    constructor(WeirdToken token) {
        _token = token;
    }

    function balanceOf(address account) external view returns (uint256) {
        return _token.balanceOf(account);
    }

    function transfer(address to, uint256 amount) external returns (bool) {
        _token.move(msg.sender, to, amount);
        return true;
    }
}

contract TokenTest is Fixture {
    WeirdToken private _token;

    function setUp() public override {
        super.setUp();
        _token = new WeirdToken();
        found(_token);
        address[3] memory holders = [alice, bob, robot1];
        for (uint256 i = 0; i < holders.length; ++i) {
            _token.mint(holders[i], 1000 ether);
            vm.prank(holders[i]);
            _token.approve(address(tasks), type(uint256).max);
        }
    }

    // -- coming in ----------------------------------------------------------------------------------------

    function test_aTokenThatReturnsFalseIsNotTakenForPaid() public {
        _token.behave(WeirdToken.Way.ReturnsFalse, address(0));
        vm.expectRevert(abi.encodeWithSelector(SafeERC20.SafeERC20FailedOperation.selector, address(_token)));
        post(alice, 100 ether);
    }

    function test_aTokenThatRevertsStopsTheRegistration() public {
        _token.behave(WeirdToken.Way.Reverts, address(0));
        vm.expectRevert(WeirdToken.Refused.selector);
        post(alice, 100 ether);
    }

    function test_aTokenThatTakesAFeeIsRefused() public {
        _token.behave(WeirdToken.Way.TakesAFee, address(0));
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.WrongAmountReceived.selector, 100 ether, 99 ether)
        );
        post(alice, 100 ether);
    }

    function test_aTokenThatMovesNothingIsRefused() public {
        _token.behave(WeirdToken.Way.MovesNothing, address(0));
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.WrongAmountReceived.selector, 100 ether, 0));
        post(alice, 100 ether);
    }

    function test_aBondWithAFeeIsRefused() public {
        setTerms(100 ether, 0, 0);
        _token.behave(WeirdToken.Way.TakesAFee, address(0));
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.WrongAmountReceived.selector, 100 ether, 99 ether)
        );
        offer(robot1, 1 ether);
    }

    // -- going out ----------------------------------------------------------------------------------------

    function _refuse(WeirdToken.Way way, address victim) private {
        _token.behave(way, victim);
    }

    function test_anExecutorThatTheTokenRefusesHoldsUpNoVerdict() public {
        for (uint8 way = 1; way <= 2; ++way) {
            uint256 snapshot = vm.snapshotState();
            ServiceId serviceId = offer(robot1, 80 ether);
            TaskId taskId = post(alice, 100 ether);
            TaskId next = post(bob, 100 ether);
            submit(taskId);
            _refuse(WeirdToken.Way(way), robot1);
            vm.expectEmit(address(tasks));
            emit ITaskManager.PaymentDeferred(robot1, 80 ether);
            judge(taskId, true);
            assertState(taskId, TaskState.Settled);
            assertAssigned(next, serviceId);
            assertEq(_token.balanceOf(alice), 920 ether, "the surplus came back");
            assertEq(tasks.pendingPayments(robot1), 80 ether);

            _refuse(WeirdToken.Way.Well, address(0));
            vm.expectEmit(address(tasks));
            emit ITaskManager.PaymentCollected(robot1, 80 ether);
            vm.prank(stranger);
            tasks.withdrawPayments(robot1);
            assertEq(_token.balanceOf(robot1), 1080 ether);
            vm.expectRevert(abi.encodeWithSelector(ITaskManager.NothingOwed.selector, robot1));
            tasks.withdrawPayments(robot1);
            vm.revertToState(snapshot);
        }
    }

    function test_aCreatorThatTheTokenRefusesHoldsUpNoService() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        TaskId next = post(bob, 100 ether);
        _refuse(WeirdToken.Way.Reverts, alice);
        for (uint8 i = 1; i <= ATTEMPTS; ++i) {
            attempt(taskId, false);
        }
        assertState(taskId, TaskState.Failed);
        assertAssigned(next, serviceId);
        assertEq(tasks.pendingPayments(alice), 100 ether);
    }

    function test_aTreasuryThatTheTokenRefusesHoldsUpNobody() public {
        setTerms(50 ether, 20 ether, 0);
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        _refuse(WeirdToken.Way.Reverts, address(organization));
        attempt(taskId, false);
        assertAssigned(taskId, serviceId);
        assertEq(tasks.pendingPayments(address(organization)), 20 ether);
        _refuse(WeirdToken.Way.Well, address(0));
        tasks.withdrawPayments(address(organization));
        assertEq(_token.balanceOf(address(organization)), 20 ether);
    }

    function test_aCollectionThatTheTokenRefusesKeepsTheDebt() public {
        TaskId taskId = post(alice, 100 ether);
        _refuse(WeirdToken.Way.Reverts, alice);
        vm.prank(alice);
        tasks.cancelTask(taskId);
        vm.expectRevert(WeirdToken.Refused.selector);
        tasks.withdrawPayments(alice);
        assertEq(tasks.pendingPayments(alice), 100 ether);
    }

    function test_aRecipientThatBurnsAllGasHoldsUpNoVerdict() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        _refuse(WeirdToken.Way.BurnsGas, robot1);
        Finding memory f = finding(taskId, Ruling.Accepted, 80 ether);
        vm.prank(oracle);
        oracleJudge.rule{gas: 1_000_000}(f, "report");
        assertState(taskId, TaskState.Settled);
        assertEq(tasks.pendingPayments(robot1), 80 ether);
        assertEq(_token.balanceOf(alice), 920 ether, "the surplus came back");
    }

    /// @dev Three payments of one call: each is judged by what is still owed after those before it.
    function test_attack_aTokenThatPaysAndSaysNoPaysTwice() public {
        setTerms(70 ether, 20 ether, 0);
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        TaskId others = post(bob, 100 ether);
        _refuse(WeirdToken.Way.MovesAndReturnsFalse, address(tasks));
        attempt(taskId, true);
        assertEq(_token.balanceOf(robot1), 1010 ether, "1000 less the bond, and the price");
        assertEq(tasks.pendingPayments(robot1) + tasks.pendingPayments(alice), 0);
        for (uint8 i = 1; i <= ATTEMPTS; ++i) {
            attempt(others, false);
        }
        assertEq(tasks.pendingPayments(address(organization)) + tasks.pendingPayments(bob), 0);
        assertEq(_token.balanceOf(address(tasks)), tasks.held());
    }

    function test_attack_whatATokenKeptOfARefusedPaymentIsStillOwed() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        post(bob, 100 ether);
        _refuse(WeirdToken.Way.MovesHalfAndReturnsFalse, address(tasks));
        attempt(taskId, true);
        assertEq(tasks.pendingPayments(robot1), 40 ether);
        assertEq(tasks.pendingPayments(alice), 10 ether);
        assertEq(_token.balanceOf(address(tasks)), tasks.held());
    }

    /// @dev The recipient pays in while it is paid, so that the balance seems untouched.
    function test_attack_aRecipientHidesThatItWasPaid() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        post(bob, 100 ether);
        submit(taskId);
        _token.mint(address(_token), 80 ether);
        vm.prank(address(_token));
        _token.approve(address(tasks), 80 ether);
        _token.reenter(address(tasks), abi.encodeCall(tasks.registerTask, (request(80 ether))));
        _refuse(WeirdToken.Way.MovesAndReturnsFalse, robot1);
        judge(taskId, true);
        assertFalse(_token.entered());
        assertEq(tasks.pendingPayments(robot1), 0);
        assertEq(_token.balanceOf(address(tasks)), tasks.held());
    }

    // -- by mistake ---------------------------------------------------------------------------------------

    function test_whatWasSentByMistakeIsRescuedAndNothingElse() public {
        setTerms(50 ether, 20 ether, 0);
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        _refuse(WeirdToken.Way.Reverts, robot1);
        judge(taskId, true);
        _refuse(WeirdToken.Way.Well, address(0));
        post(alice, 100 ether);
        // A bond, what robot1 is owed, and the reward of a live task.
        assertEq(tasks.held(), 230 ether);
        vm.prank(bob);
        _token.transfer(address(tasks), 7 ether);
        vm.expectEmit(address(organization));
        emit IOrganization.TokensRescued(_token, bob, 7 ether);
        vm.startPrank(admin);
        organization.rescueTokens(_token, bob);
        organization.rescueTokens(_token, bob);
        vm.stopPrank();
        assertEq(_token.balanceOf(bob), 1000 ether);
        assertEq(_token.balanceOf(address(tasks)), 230 ether);
        tasks.withdrawPayments(robot1);
        assertEq(tasks.held(), 150 ether);
        assertEq(_token.balanceOf(address(tasks)), 150 ether);
    }

    /// @dev As of tokens that were moved behind a proxy and kept their old address.
    function test_aSecondAddressOfTheTokenRescuesNeitherEscrowNorTreasury() public {
        SecondAddress second = new SecondAddress(_token);
        post(alice, 100 ether);
        bytes memory refused = abi.encodeWithSelector(IOrganization.NotByMistake.selector, address(second));
        vm.startPrank(admin);
        vm.expectRevert(refused);
        organization.rescueTokens(ERC20(address(second)), admin);
        vm.stopPrank();
        assertEq(_token.balanceOf(address(tasks)), 100 ether);
        vm.prank(alice);
        tasks.cancelTask(taskNo(1));
        _token.mint(address(organization), 5 ether);
        vm.prank(admin);
        vm.expectRevert(refused);
        organization.rescueTokens(ERC20(address(second)), admin);
        assertEq(_token.balanceOf(address(organization)), 5 ether);
    }

    function test_otherTokensAreRescuedFromBothContracts() public {
        vm.startPrank(bob);
        coin.transfer(address(tasks), 3 ether);
        coin.transfer(address(organization), 4 ether);
        vm.stopPrank();
        uint256 before = coin.balanceOf(bob);
        vm.prank(admin);
        organization.rescueTokens(coin, bob);
        assertEq(coin.balanceOf(bob), before + 7 ether);
        // What the treasury has is the treasurer's.
        _token.mint(address(organization), 5 ether);
        vm.prank(admin);
        organization.rescueTokens(_token, bob);
        assertEq(_token.balanceOf(address(organization)), 5 ether);
    }

    function test_onlyTheOrganizationRescues() public {
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotOrganization.selector, admin));
        vm.prank(admin);
        tasks.rescue(_token, admin);
    }

    // -- in the middle ------------------------------------------------------------------------------------

    function test_aTokenThatReentersGetsNowhere() public {
        offer(robot1, 80 ether);
        TaskId open = post(address(_token));
        TaskId running = post(alice, 100 ether);
        submit(open);
        bytes[] memory calls = new bytes[](6);
        calls[0] = abi.encodeCall(ITaskManager.cancelTask, (running));
        calls[1] = abi.encodeCall(ITaskManager.registerTask, (request(1 ether)));
        calls[2] = abi.encodeCall(ITaskManager.expireTask, (open));
        calls[3] = abi.encodeCall(ITaskManager.matchTask, (running, NO_SERVICE));
        calls[4] = abi.encodeCall(ITaskManager.withdrawPayments, (alice));
        calls[5] = abi.encodeCall(ITaskManager.submitProof, (running, 1, PROOF, URI));
        for (uint256 i = 0; i < calls.length; ++i) {
            uint256 snapshot = vm.snapshotState();
            _token.reenter(address(tasks), calls[i]);
            judge(open, true);
            assertFalse(_token.entered(), "entered");
            assertEq(
                _token.answer(),
                abi.encodeWithSelector(ReentrancyGuardTransient.ReentrancyGuardReentrantCall.selector)
            );
            assertEq(_token.balanceOf(robot1), 1080 ether);
            assertEq(_token.balanceOf(address(tasks)), 100 ether);
            vm.revertToState(snapshot);
        }
    }

    function test_aTokenThatReentersWhileAnAuditorPaysGetsNowhere() public {
        offer(robot1, 80 ether);
        TaskId open = post(address(_token));
        submit(open);
        judgeAs(oracle, open, Ruling.None, 0);
        bytes[] memory calls = new bytes[](2);
        calls[0] = abi.encodeCall(ITaskManager.conclude, (open));
        calls[1] = abi.encodeCall(
            ITaskManager.rule, (open, 1, PROOF, Ruling.Accepted, Fault.Nobody, 80 ether, 0, REPORT)
        );
        for (uint256 i = 0; i < 4; ++i) {
            uint256 snapshot = vm.snapshotState();
            _token.reenter(address(tasks), calls[i % 2]);
            uint256 paid = i < 2 ? 50 ether : 0;
            if (i < 2) {
                judgeAs(auditor, open, Ruling.Accepted, paid);
            } else {
                vm.warp(tasks.standing(open).until + 1);
                tasks.conclude(open);
            }
            assertFalse(_token.entered(), "entered");
            assertEq(_token.balanceOf(robot1), 1000 ether + paid);
            assertEq(_token.balanceOf(address(tasks)), 0);
            vm.revertToState(snapshot);
        }
    }

    function test_aProviderThatIsTheTokenCannotLeaveInTheMiddle() public {
        setTerms(50 ether, 20 ether, 0);
        _token.mint(address(_token), 100 ether);
        vm.startPrank(address(_token));
        _token.approve(address(tasks), type(uint256).max);
        ServiceId serviceId = services.registerService(CLEANING, 80 ether, NO_LIMIT, true, "");
        vm.stopPrank();
        TaskId taskId = post(alice, 100 ether);
        TaskId waiting = post(bob, 100 ether);
        submit(taskId);
        // It retires while it is being paid: the next task runs already, so its bond waits for that one.
        _token.reenter(
            address(services),
            abi.encodeCall(services.updateService, (serviceId, 80 ether, ServiceState.Retired))
        );
        judge(taskId, true);
        assertTrue(_token.entered(), "retired");
        assertAssigned(waiting, serviceId);
        assertEq(_token.balanceOf(address(tasks)), 150 ether);
        attempt(waiting, true);
        assertEq(_token.balanceOf(address(tasks)), 0);
    }

    /// @dev A task of the organization's token itself, so that it is a party that calls back.
    function post(address creator) private returns (TaskId taskId) {
        _token.mint(creator, 100 ether);
        vm.startPrank(creator);
        _token.approve(address(tasks), type(uint256).max);
        taskId = tasks.registerTask(request(100 ether));
        vm.stopPrank();
    }
}
