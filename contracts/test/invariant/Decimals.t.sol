// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Organization} from "../../src/Organization.sol";
import {ServiceManager} from "../../src/ServiceManager.sol";
import {TaskManager} from "../../src/TaskManager.sol";
import {ServiceState} from "../../src/interfaces/IServiceManager.sol";
import {Task, TaskState} from "../../src/interfaces/ITaskManager.sol";
import {RoleJudge} from "../../src/judges/RoleJudge.sol";
import {LowestPrice} from "../../src/policies/LowestPrice.sol";
import {ServiceId} from "../../src/types/ServiceId.sol";
import {NO_TASK, TaskId} from "../../src/types/TaskId.sol";
import {Fixture} from "../Fixture.sol";
import {PlainToken} from "../PlainToken.sol";

/// @notice Organizations that pay in tokens with different decimals, and in which the same happens.
contract DecimalsInvariants is Fixture {
    struct Twin {
        Organization organization;
        ServiceManager services;
        TaskManager tasks;
        RoleJudge oracleJudge;
        PlainToken token;
        /// @dev How many of the token's smallest unit are a cent.
        uint256 cent;
    }

    uint256 private constant ROBOTS = 3;
    uint256 private constant MOST = 500_000;

    Twin[] private _twins;
    uint256 private _wronglyFounded;
    uint256 private _wronglyRefused;

    function setUp() public override {
        super.setUp();
        LowestPrice lowest = LowestPrice(deployed("LowestPrice"));
        address[3] memory robots = [robot1, robot2, robot3];
        uint8[3] memory decimals = [18, 6, 2];
        for (uint256 i = 0; i < decimals.length; ++i) {
            PlainToken token = new PlainToken(decimals[i]);
            found(token);
            uint256 cent = 10 ** (decimals[i] - 2);
            _twins.push(Twin(organization, services, tasks, oracleJudge, token, cent));
            vm.prank(admin);
            organization.setPolicy(lowest);
            vm.prank(alice);
            token.approve(address(tasks), type(uint256).max);
            for (uint256 j = 0; j < ROBOTS; ++j) {
                offer(robots[j], 0);
            }
        }
        bytes4[] memory actions = new bytes4[](4);
        (actions[0], actions[1]) = (this.askFor.selector, this.pay.selector);
        (actions[2], actions[3]) = (this.work.selector, this.foundAnother.selector);
        targetSelector(FuzzSelector(address(this), actions));
        targetContract(address(this));
    }

    /// forge-config: default.invariant.runs = 16
    /// @notice What holds after each call. One campaign asks for all of it: others would make the same calls again.
    function invariant_everythingHolds() public view {
        _decimalsChangeNothingButAmounts();
        _onlyTokensThatHaveCentsAndFitAreTaken();
    }

    /// @dev Who works, at which price, and what that makes of its reputation does not depend on the decimals.
    function _decimalsChangeNothingButAmounts() private view {
        Twin memory first = _twins[0];
        for (uint256 i = 1; i < _twins.length; ++i) {
            Twin memory other = _twins[i];
            for (uint256 number = 1; number <= first.tasks.taskCount(); ++number) {
                TaskId taskId = TaskId.wrap(number);
                (Task memory a, Task memory b) = (first.tasks.task(taskId), other.tasks.task(taskId));
                assertEq(uint8(a.state), uint8(b.state), "state");
                assertEq(a.serviceId, b.serviceId, "service");
                assertEq(a.price * other.cent, b.price * first.cent, "price");
            }
            for (uint256 number = 1; number <= ROBOTS; ++number) {
                ServiceId serviceId = ServiceId.wrap(number);
                assertEq(
                    first.services.service(serviceId).reputation,
                    other.services.service(serviceId).reputation,
                    "reputation"
                );
            }
        }
    }

    /// @dev An organization pays in a token with 2 to 18 decimals, and in no other.
    function _onlyTokensThatHaveCentsAndFitAreTaken() private view {
        assertEq(_wronglyFounded, 0, "founded");
        assertEq(_wronglyRefused, 0, "refused");
    }

    function askFor(uint256 which, uint256 cents) external {
        ServiceId serviceId = serviceNo(bound(which, 1, ROBOTS));
        cents = bound(cents, 0, MOST);
        for (uint256 i = 0; i < _twins.length; ++i) {
            uint256 cent = _in(i);
            if (services.service(serviceId).taskId == NO_TASK) {
                update(serviceId, cents * cent, ServiceState.Active);
            }
        }
    }

    function pay(uint256 cents) external {
        cents = bound(cents, 0, MOST);
        for (uint256 i = 0; i < _twins.length; ++i) {
            uint256 cent = _in(i);
            _twins[i].token.mint(alice, cents * cent);
            post(alice, cents * cent);
        }
    }

    /// @dev Mostly well.
    function work(uint256 which, uint256 quality) external {
        ServiceId serviceId = serviceNo(bound(which, 1, ROBOTS));
        for (uint256 i = 0; i < _twins.length; ++i) {
            _in(i);
            TaskId taskId = services.service(serviceId).taskId;
            if (taskId != NO_TASK && state(taskId) == TaskState.Assigned) attempt(taskId, quality % 4 != 0);
        }
    }

    function foundAnother(uint256 decimals) external {
        PlainToken token = new PlainToken(uint8(bound(decimals, 0, 40)));
        bool right = token.decimals() >= 2 && token.decimals() <= 18;
        Organization other = organizationOf(token, tasks);
        try vm.deployCode(artifactOf("ServiceManager"), abi.encode(other, tasks)) {
            if (!right) ++_wronglyFounded;
        } catch {
            if (right) ++_wronglyRefused;
        }
    }

    /// @dev From now on the others' functions act here.
    function _in(uint256 i) private returns (uint256 cent) {
        Twin storage twin = _twins[i];
        (organization, services, tasks) = (twin.organization, twin.services, twin.tasks);
        oracleJudge = twin.oracleJudge;
        return twin.cent;
    }
}
