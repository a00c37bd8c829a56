// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {Organization} from "../src/Organization.sol";
import {TaskManager} from "../src/TaskManager.sol";
import {IServiceManager, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {ITaskManager, TaskState, Ruling} from "../src/interfaces/ITaskManager.sol";
import {Units} from "../src/libraries/Units.sol";
import {LowestPrice} from "../src/policies/LowestPrice.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";
import {PlainToken} from "./PlainToken.sol";

/// @notice An organization that pays in a token with six decimals.
contract DecimalsTest is Fixture {
    uint256 private constant TOKEN = 1e6;

    PlainToken private _token;

    function setUp() public override {
        super.setUp();
        _pays(6);
    }

    function test_aTaskGoesFromItsRewardToItsPayment() public {
        offer(robot1, 80 * TOKEN);
        TaskId taskId = post(alice, 100 * TOKEN);
        assertEq(tasks.held(), 100 * TOKEN);
        submit(taskId);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskSettled(taskId, robot1, 80 * TOKEN, 20 * TOKEN);
        judge(taskId, true);
        assertEq(_token.balanceOf(robot1), 1080 * TOKEN);
        assertEq(_token.balanceOf(alice), 920 * TOKEN);
        assertEq(tasks.held(), 0);
    }

    function test_bondsPenaltiesAndPartPaymentsAreExact() public {
        setTerms(uint96(50 * TOKEN), uint96(20 * TOKEN + 1), 0);
        ServiceId serviceId = offer(robot1, 80 * TOKEN);
        TaskId taskId = post(alice, 100 * TOKEN);
        attempt(taskId, false);
        assertEq(_token.balanceOf(address(organization)), 20 * TOKEN + 1);
        submit(taskId);
        judgeAs(oracle, taskId, Ruling.Accepted, 1);
        update(serviceId, 80 * TOKEN, ServiceState.Retired);
        assertEq(
            _token.balanceOf(robot1), 1000 * TOKEN - 20 * TOKEN, "less the penalty, with one unit of pay"
        );
        assertEq(_token.balanceOf(alice), 1000 * TOKEN - 1);
        assertEq(_token.balanceOf(address(tasks)), 0);
    }

    function test_thePriceIsMeantToTheSmallestUnit() public {
        offer(robot1, 1);
        TaskId taskId = post(alice, 1);
        attempt(taskId, true);
        assertEq(_token.balanceOf(robot1), 1000 * TOKEN + 1);
        uint256 max = Units.max(1);
        assertGt(max, 1e11 * TOKEN, "more than any such token has");
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.InvalidPrice.selector, max + 1, 1, max));
        offer(robot1, max + 1);
    }

    function test_smallPricesAreToldApart() public {
        LowestPrice lowest = LowestPrice(deployed("LowestPrice"));
        vm.prank(admin);
        organization.setPolicy(lowest);
        offer(robot1, 3 * TOKEN / 100);
        ServiceId cheap = offer(robot2, 2 * TOKEN / 100);
        assertAssigned(post(alice, TOKEN), cheap);
        assertEq(tasks.task(post(alice, TOKEN)).price, 3 * TOKEN / 100);
        TaskId waits = post(alice, 2 * TOKEN / 100 - 1);
        assertState(waits, TaskState.Open);
        assertEq(tasks.queues().oldestOpen(serviceNo(1), cleaning(), 19_900), waits, "three digits of it");
    }

    /// @dev A hundred tokens make a name, not a hundred billion of their smallest units.
    function test_reputationCountsTokens() public {
        ServiceId serviceId = offer(robot1, 500 * TOKEN);
        assertEq(services.service(serviceId).reputation, 32);
        attempt(post(alice, 500 * TOKEN), true);
        assertEq(services.service(serviceId).reputation, 54, "64 * 600 / 700");
        attempt(post(bob, 500 * TOKEN), false);
        assertEq(services.service(serviceId).reputation, 32);
    }

    function test_reputationIsTheSameInEachToken() public {
        uint8[4] memory decimals = [2, 6, 9, 18];
        for (uint256 i = 0; i < decimals.length; ++i) {
            _pays(decimals[i]);
            ServiceId serviceId = offer(robot1, 30 * 10 ** decimals[i]);
            attempt(post(alice, 30 * 10 ** decimals[i]), true);
            assertEq(services.service(serviceId).reputation, 36, "64 * 130 / 230");
        }
    }

    function test_tokensWithoutCentsAndTokensThatAreTooFineAreRefused() public {
        uint8[5] memory refused = [0, 1, 19, 77, 255];
        for (uint256 i = 0; i < refused.length; ++i) {
            PlainToken token = new PlainToken(refused[i]);
            bytes memory reason =
                abi.encodeWithSelector(Units.UnsupportedDecimals.selector, token, refused[i], 2, 18);
            uint64 nonce = vm.getNonce(address(this));
            TaskManager later = TaskManager(vm.computeCreateAddress(address(this), nonce + 2));
            Organization fake = organizationOf(token, later);
            vm.expectRevert(reason);
            deployed("ServiceManager", abi.encode(fake, later));
            vm.expectRevert(reason);
            deployed("TaskManager", abi.encode(fake, services));
        }
    }

    function test_aTokenThatDoesNotSayItsDecimalsIsRefused() public {
        IERC20 silent = IERC20(address(policy));
        uint64 nonce = vm.getNonce(address(this));
        TaskManager later = TaskManager(vm.computeCreateAddress(address(this), nonce + 1));
        vm.mockCall(
            address(policy), abi.encodeCall(IERC20.approve, (address(later), NO_LIMIT)), abi.encode(true)
        );
        Organization fake = organizationOf(silent, later);
        vm.expectRevert();
        deployed("TaskManager", abi.encode(fake, services));
    }

    /// @dev In a token with six decimals the unit of prices is its smallest unit.
    function test_aReferencePriceIsAPriceOfTheToken() public {
        vm.startPrank(admin);
        organization.setWindows(CLEANING, windows(SHORTEST, 3 minutes), uint96(30 * TOKEN));
        uint96[2] memory wrong = [0, uint96(Units.max(1)) + 1];
        for (uint256 i = 0; i < wrong.length; ++i) {
            vm.expectRevert(
                abi.encodeWithSelector(IServiceManager.InvalidPrice.selector, wrong[i], 1, Units.max(1))
            );
            organization.setWindows(CLEANING, windows(SHORTEST, 3 minutes), wrong[i]);
        }
        vm.stopPrank();
        ServiceId serviceId = offer(robot1, 500 * TOKEN);
        attempt(post(alice, 500 * TOKEN), true);
        assertEq(services.service(serviceId).reputation, 36, "64 * 130 / 230");
    }

    function _pays(uint8 decimals) private {
        _token = new PlainToken(decimals);
        found(_token);
        address[3] memory holders = [alice, bob, robot1];
        for (uint256 i = 0; i < holders.length; ++i) {
            _token.mint(holders[i], 1000 * 10 ** decimals);
            vm.prank(holders[i]);
            _token.approve(address(tasks), type(uint256).max);
        }
    }
}
