// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Hire, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {NOBODY} from "../src/types/Passed.sol";
import {KindId} from "../src/types/KindId.sol";
import {NO_SERVICE, ServiceId} from "../src/types/ServiceId.sol";
import {Fixture} from "./Fixture.sol";
import {Outcome} from "../src/interfaces/IProviders.sol";

/// @notice Services of one price and reputation that wait, in short lines, whose services are in the line's word, and in
/// long ones. Whoever begins to wait comes last, and leaves from where it stands.
contract LinesTest is Fixture {
    uint256 private constant PRICE = 10 ether;

    /// @dev The services that wait, as they should: the first is the next to get a task.
    ServiceId[] private _waiting;
    ServiceId[] private _paused;
    ServiceId[] private _working;
    uint40 private _places = 1000;

    /// @dev Each action is a number: what happens, and to which service.
    function testFuzz_servicesComeAndGoInAnyOrder(uint16[64] calldata actions) public {
        for (uint256 i = 0; i < 20; ++i) {
            _waiting.push(offer(i < 8 ? robot1 : i < 16 ? robot2 : robot3, PRICE));
        }
        for (uint256 i = 0; i < actions.length; ++i) {
            (uint256 what, uint256 which) = (actions[i] % 7, actions[i] / 7);
            if (what == 0) _takeTask();
            else if (what == 1) _endTask(which);
            else if (what == 2) _pause(which);
            else if (what == 3) _activate(which);
            else if (what == 4) _takeMany(which % 4);
            else _pauseLast(which % 8);
        }
        while (_waiting.length != 0) {
            _takeTask();
        }
        _takeTask();
    }

    function test_whoJoinsAShortLineWritesToNoNeighbour() public {
        for (uint256 i = 0; i < 6; ++i) {
            _waiting.push(offer(robot1, PRICE));
        }
        _takeTask();
        ServiceId last = _waiting[_waiting.length - 1];
        bytes32 word = bytes32(uint256(keccak256(abi.encode(last, uint256(1)))) + 1);
        assertNotEq(vm.load(address(services), word), 0, "it has a place");
        vm.record();
        _endTask(0);
        (, bytes32[] memory written) = vm.accesses(address(services));
        assertGt(written.length, 0);
        for (uint256 i = 0; i < written.length; ++i) {
            assertNotEq(written[i], word);
        }
    }

    /// @dev The service that has waited longest gets a task, or none if none waits.
    function _takeTask() private {
        KindId kind = organization.numberOf(CLEANING);
        vm.prank(address(tasks));
        (ServiceId taker,,,) = services.reserve(NO_SERVICE, kind, PRICE, NOBODY, taskNo(1), Hire.None);
        assertEq(ServiceId.unwrap(taker), _waiting.length == 0 ? 0 : ServiceId.unwrap(_waiting[0]));
        if (_waiting.length != 0) _working.push(_leave(_waiting, 0));
    }

    function _takeMany(uint256 count) private {
        for (uint256 i = 0; i < count; ++i) {
            _takeTask();
        }
    }

    function _endTask(uint256 which) private {
        if (_working.length == 0) return;
        ServiceId serviceId = _leave(_working, which % _working.length);
        vm.prank(address(tasks));
        services.release(serviceId, Outcome.Unjudged, 0, alice, ++_places);
        _waiting.push(serviceId);
    }

    /// @dev The latest of a line leave it while earlier ones stay.
    function _pauseLast(uint256 count) private {
        for (uint256 i = 0; i < count && _waiting.length != 0; ++i) {
            _pause(_waiting.length - 1);
        }
    }

    function _pause(uint256 which) private {
        if (_waiting.length == 0) return;
        ServiceId serviceId = _leave(_waiting, which % _waiting.length);
        update(serviceId, PRICE, ServiceState.Paused);
        _paused.push(serviceId);
    }

    /// @dev With places of its own, because the task manager does not know of these tasks.
    function _activate(uint256 which) private {
        if (_paused.length == 0) return;
        ServiceId serviceId = _leave(_paused, which % _paused.length);
        vm.mockCall(address(tasks), abi.encodeWithSelector(tasks.onServiceFree.selector), "");
        update(serviceId, PRICE, ServiceState.Active);
        vm.clearMockedCalls();
        vm.prank(address(tasks));
        services.enqueue(serviceId, ++_places);
        _waiting.push(serviceId);
    }

    function _leave(ServiceId[] storage list, uint256 index) private returns (ServiceId serviceId) {
        serviceId = list[index];
        for (uint256 i = index; i + 1 < list.length; ++i) {
            list[i] = list[i + 1];
        }
        list.pop();
    }
}
