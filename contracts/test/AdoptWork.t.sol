// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {ServiceManager} from "../src/ServiceManager.sol";
import {IServiceManager} from "../src/interfaces/IServiceManager.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";
import {PlainToken} from "./PlainToken.sol";

/// @notice An organization that follows another one knows providers for what they did there.
contract AdoptWorkTest is Fixture {
    ServiceManager private before;

    function setUp() public override {
        super.setUp();
        before = services;
        offer(robot1, 80 ether);
        for (uint256 i = 0; i < 3; ++i) {
            attempt(post(alice, 100 ether), true);
        }
        offer(robot2, 50 ether);
        // The first service waits longest no more.
        TaskId taskId = post(alice, 60 ether);
        attempt(taskId, false);
        _follow(coin);
    }

    /// @dev Another organization is what the variables name from now on.
    function _follow(IERC20 token) private {
        found(token);
        vm.prank(alice);
        coin.approve(address(tasks), type(uint256).max);
    }

    function _both() private view returns (address[] memory providers) {
        providers = new address[](2);
        (providers[0], providers[1]) = (robot1, robot2);
    }

    function _adopt() private {
        vm.prank(admin);
        services.adoptWork(before, _both());
    }

    function _assertSame(address provider) private view {
        (uint256 done, uint256 failed) = before.workOf(provider);
        (uint256 done_, uint256 failed_) = services.workOf(provider);
        assertEq(done_, done, "done");
        assertEq(failed_, failed, "failed");
    }

    function test_whatWasDoneIsToldInBillionthsOfAToken() public view {
        (uint256 done, uint256 failed) = before.workOf(robot1);
        assertEq(done, 240e9);
        assertEq(failed, 0);
        (done, failed) = before.workOf(robot2);
        assertEq(done, 0);
        assertEq(failed, 50e9);
    }

    function test_providersAreKnownForTheirWorkBefore() public {
        vm.expectEmit(address(services));
        emit IServiceManager.WorkAdopted(robot1, address(before), 240 ether, 0);
        vm.expectEmit(address(services));
        emit IServiceManager.WorkAdopted(robot2, address(before), 0, 50 ether);
        _adopt();
        _assertSame(robot1);
        _assertSame(robot2);
        ServiceId serviceId = offer(robot1, 80 ether);
        assertEq(services.service(serviceId).reputation, 49, "340 of 440");
        assertEq(services.service(offer(robot2, 50 ether)).reputation, 25, "100 of 250");
        assertEq(services.service(offer(robot3, 50 ether)).reputation, 32);
    }

    function test_itIsForgottenAsFastAsThere() public {
        _adopt();
        vm.warp(block.timestamp + 90 days);
        _assertSame(robot1);
        (uint256 done,) = services.workOf(robot1);
        assertEq(done, 120e9);
    }

    function test_itGoesOnFromThere() public {
        _adopt();
        offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), true);
        (uint256 done,) = services.workOf(robot1);
        assertEq(done, 320e9);
    }

    function test_adoptedAgainItDoesNotCountTwice() public {
        _adopt();
        _adopt();
        _assertSame(robot1);
    }

    function test_onlyTheAdministratorMay() public {
        vm.prank(robot1);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.NotAdministrator.selector, robot1));
        services.adoptWork(before, _both());
    }

    function test_afterTheFirstTaskNothingIsAdopted() public {
        vm.prank(alice);
        coin.approve(address(tasks), type(uint256).max);
        post(alice, 100 ether);
        vm.prank(admin);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.TasksWerePosted.selector, 1));
        services.adoptWork(before, _both());
    }

    function test_tokensOfOtherDecimalsCountTheSame() public {
        for (uint8 decimals = 2; decimals <= 12; decimals += 4) {
            _follow(new PlainToken(decimals));
            _adopt();
            ServiceId serviceId = offer(robot1, 80 * 10 ** decimals);
            assertEq(services.service(serviceId).reputation, 49);
            _assertSame(robot1);
            // And back, from fewer decimals to more.
            (ServiceManager last, ServiceManager first) = (services, before);
            before = last;
            _follow(coin);
            _adopt();
            _assertSame(robot1);
            before = first;
        }
    }

    function testFuzz_whateverTheOtherSaysIsKept(uint128 done, uint128 failed) public {
        vm.mockCall(
            address(before), abi.encodeCall(IServiceManager.workOf, (robot1)), abi.encode(done, failed)
        );
        _adopt();
        (uint256 done_, uint256 failed_) = services.workOf(robot1);
        assertEq(done_, done > type(uint64).max ? type(uint64).max : done);
        assertEq(failed_, failed > type(uint64).max ? type(uint64).max : failed);
        assertLe(services.service(offer(robot1, 80 ether)).reputation, 63);
    }
}
