// SPDX-License-Identifier: MIT
pragma solidity ^0.8.28;

import {Test} from "forge-std/Test.sol";
import {FirstFitQueue} from "../src/libraries/FirstFitQueue.sol";

contract FirstFitQueueTest is Test {
    using FirstFitQueue for FirstFitQueue.Queue;

    FirstFitQueue.Queue private _queue;

    /// @dev The queue again, as a list that is searched from end to end.
    uint64[] private _keys;
    mapping(uint64 key => uint64) private _weights;

    function insert(uint64 key, uint64 weight) external {
        _queue.insert(key, weight);
    }

    function remove(uint64 key) external {
        _queue.remove(key);
    }

    function test_anEmptyQueueHasNoFirst() public view {
        assertEq(_queue.first(0), 0);
    }

    function test_theLowestKeyThatWeighsEnoughIsFirst() public {
        _queue.insert(5, 10);
        _queue.insert(3, 7);
        _queue.insert(9, 20);
        assertEq(_queue.first(0), 3);
        assertEq(_queue.first(7), 3);
        assertEq(_queue.first(8), 5);
        assertEq(_queue.first(20), 9);
        assertEq(_queue.first(21), 0);
    }

    function test_aKeyIsInsertedOnce() public {
        _queue.insert(5, 10);
        _queue.insert(6, 10);
        vm.expectRevert(abi.encodeWithSelector(FirstFitQueue.KeyTaken.selector, 5));
        this.insert(5, 11);
    }

    function test_whatIsNotThereCannotBeRemoved() public {
        vm.expectRevert(abi.encodeWithSelector(FirstFitQueue.KeyMissing.selector, 1));
        this.remove(1);
        _queue.insert(5, 10);
        vm.expectRevert(abi.encodeWithSelector(FirstFitQueue.KeyMissing.selector, 4));
        this.remove(4);
        _queue.insert(6, 10);
        vm.expectRevert(abi.encodeWithSelector(FirstFitQueue.KeyMissing.selector, 7));
        this.remove(7);
        vm.expectRevert(abi.encodeWithSelector(FirstFitQueue.KeyMissing.selector, 500));
        this.remove(500);
    }

    function testFuzz_itAnswersAsAListWould(uint256 seed, uint8 bits) public {
        bits = uint8(bound(bits, 1, 63));
        for (uint256 i = 0; i < 60; ++i) {
            seed = uint256(keccak256(abi.encode(seed)));
            uint64 key = uint64(bound(seed >> 64, 1, (1 << bits) - 1));
            uint64 weight = uint64(seed % 16);
            bool present = _index(key) < _keys.length;
            if (present) {
                _queue.remove(key);
                _keys[_index(key)] = _keys[_keys.length - 1];
                _keys.pop();
            } else {
                _queue.insert(key, weight);
                _keys.push(key);
                _weights[key] = weight;
            }
            for (uint64 minWeight = 0; minWeight <= 16; minWeight += 4) {
                assertEq(_queue.first(minWeight), _search(minWeight));
            }
        }
    }

    /// @dev A full queue of neighbours is 2^n leaves under n levels: the deepest path costs n reads.
    function test_theCostOfSearchingGrowsWithTheLogarithm() public {
        for (uint64 key = 1; key <= 1024; ++key) {
            _queue.insert(key, key);
        }
        vm.cool(address(this));
        uint256 before = gasleft();
        assertEq(_queue.first(1024), 1024);
        assertLt(before - gasleft(), 12 * 2100 + 10_000);
    }

    function _search(uint64 minWeight) private view returns (uint64 lowest) {
        for (uint256 i = 0; i < _keys.length; ++i) {
            uint64 key = _keys[i];
            if (_weights[key] >= minWeight && (lowest == 0 || key < lowest)) lowest = key;
        }
    }

    function _index(uint64 key) private view returns (uint256 i) {
        while (i < _keys.length && _keys[i] != key) ++i;
    }
}
