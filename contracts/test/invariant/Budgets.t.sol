// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {CommonBase} from "forge-std/Base.sol";
import {StdUtils} from "forge-std/StdUtils.sol";
import {MAX_PAUSE} from "../../src/interfaces/IOrganization.sol";
import {IECoin} from "../../src/IECoin.sol";
import {Organization} from "../../src/Organization.sol";
import {ITaskManager, TaskRequest} from "../../src/interfaces/ITaskManager.sol";
import {TaskId} from "../../src/types/TaskId.sol";
import {GUARDIAN_ROLE, OPERATOR_ROLE, TREASURER_ROLE} from "../../src/types/Roles.sol";
import {Fixture} from "../Fixture.sol";

/// @notice Operator, treasurer and guardian do all that they can; the administrator changes budgets meanwhile.
contract TreasuryHandler is CommonBase, StdUtils {
    struct Payment {
        uint256 time;
        uint256 amount;
    }

    Organization private immutable _organization;
    ITaskManager private immutable _tasks;
    IECoin private immutable _coin;
    address private immutable _admin;
    address private immutable _guardian;
    address private immutable _creator;
    TaskRequest private _request;
    TaskId[] private _posted;
    uint256 private _pauseEnds;
    mapping(bytes32 role => Payment[]) private _payments;
    mapping(bytes32 role => uint256) private _amounts;
    mapping(bytes32 role => uint256) private _periods;

    /// @notice What the rules forbid and happened nevertheless; empty if nothing did.
    string public violation;

    constructor(
        Organization organization,
        IECoin coin,
        address admin,
        address guardian,
        address creator,
        TaskRequest memory request
    ) {
        (_organization, _coin, _admin, _guardian, _creator) = (organization, coin, admin, guardian, creator);
        _tasks = organization.tasks();
        _request = request;
    }

    function withdraw(uint256 amount) external {
        amount = bound(amount, 0, _min(300 ether, _coin.balanceOf(address(_organization))));
        bytes32 role = TREASURER_ROLE;
        vm.prank(_admin);
        try _organization.withdraw(_creator, amount) {
            _payments[role].push(Payment(block.timestamp, amount));
        } catch {
            if (_periods[role] == 0) violation = "a withdrawal without a budget failed";
        }
        // So that the treasury does not run dry.
        uint256 back = _min(amount, _coin.balanceOf(_creator));
        vm.prank(_creator);
        bool moved = _coin.transfer(address(_organization), back);
        assert(moved);
    }

    function post(uint256 amount) external {
        TaskRequest memory request = _request;
        request.reward = bound(amount, 0, _min(300 ether, _coin.balanceOf(address(_organization))));
        bytes32 role = OPERATOR_ROLE;
        vm.prank(_admin);
        try _organization.registerTask(request) returns (TaskId taskId) {
            if (_isPaused()) violation = "a task was posted in a pause";
            _payments[role].push(Payment(block.timestamp, request.reward));
            _posted.push(taskId);
        } catch {
            if (_periods[role] == 0 && !_isPaused()) violation = "a task without a budget was refused";
        }
    }

    /// @dev Reverts, which fails the run, if a pause or a budget stops it.
    function cancel() external {
        if (_posted.length == 0) return;
        TaskId taskId = _posted[_posted.length - 1];
        _posted.pop();
        vm.prank(_admin);
        _organization.cancelTask(taskId);
    }

    function setBudget(bool operators, uint256 amount, uint256 period) external {
        bytes32 role = operators ? OPERATOR_ROLE : TREASURER_ROLE;
        amount = bound(amount, 1 ether, 500 ether);
        // One in eight is no limit.
        period = period % 8 == 0 ? 0 : bound(period, 1 hours, 2 days);
        vm.prank(_admin);
        _organization.setBudget(role, uint96(amount), uint24(period));
        (_amounts[role], _periods[role]) = (amount, period);
        delete _payments[role];
    }

    function pause(uint256 duration) external {
        duration = bound(duration, 1, uint256(MAX_PAUSE) * 2);
        bool right = duration <= MAX_PAUSE && block.timestamp >= _pauseEnds + MAX_PAUSE;
        vm.prank(_guardian);
        try _organization.pauseTasks(uint32(duration)) {
            if (!right) violation = "a guardian paused too soon, or for too long";
            _pauseEnds = block.timestamp + duration;
        } catch {
            if (right) violation = "a guardian could not pause";
        }
    }

    function resume(bool administrator) external {
        vm.prank(administrator ? _admin : _guardian);
        _organization.resumeTasks();
        _pauseEnds = _min(_pauseEnds, block.timestamp);
    }

    function wait(uint256 time) external {
        vm.warp(block.timestamp + bound(time, 1 minutes, 2 days));
    }

    /// @notice What left the treasury within a period that ends now, and twice the budget.
    function spent(bytes32 role) external view returns (uint256 sum, uint256 max) {
        if (_periods[role] == 0) return (0, 0);
        Payment[] storage payments = _payments[role];
        for (uint256 i = 0; i < payments.length; ++i) {
            if (payments[i].time + _periods[role] > block.timestamp) sum += payments[i].amount;
        }
        max = 2 * _amounts[role];
    }

    function _isPaused() private view returns (bool) {
        return block.timestamp < _pauseEnds;
    }

    function _min(uint256 a, uint256 b) private pure returns (uint256) {
        return a < b ? a : b;
    }
}

contract BudgetInvariants is Fixture {
    TreasuryHandler private _handler;

    function setUp() public override {
        super.setUp();
        address guardian = makeAddr("guardian");
        bytes32 role = GUARDIAN_ROLE;
        vm.prank(admin);
        organization.grantRole(role, guardian);
        _handler = new TreasuryHandler(organization, coin, admin, guardian, alice, request(0));
        targetContract(address(_handler));
    }

    /// @notice What holds after each call. One campaign asks for all of it: others would make the same calls again.
    function invariant_everythingHolds() public view {
        _noRoleDrainsTheTreasury();
        _pausesStopNewTasksForAShortTime();
    }

    /// @dev No role takes more than twice its budget out of the treasury in any time as long as a period.
    function _noRoleDrainsTheTreasury() private view {
        bytes32[2] memory roles = [OPERATOR_ROLE, TREASURER_ROLE];
        for (uint256 i = 0; i < roles.length; ++i) {
            (uint256 sum, uint256 max) = _handler.spent(roles[i]);
            assertLe(sum, max);
        }
    }

    /// @dev Pauses stop new tasks and nothing else, and end.
    function _pausesStopNewTasksForAShortTime() private view {
        assertEq(_handler.violation(), "");
        assertLe(organization.pausedUntil(), block.timestamp + MAX_PAUSE);
    }
}
