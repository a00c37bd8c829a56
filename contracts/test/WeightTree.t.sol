// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Test} from "forge-std/Test.sol";
import {WeightTree} from "../src/libraries/WeightTree.sol";
import {MAX_MAJOR, MAX_MINOR, weigh} from "../src/types/Weight.sol";

contract WeightTreeTest is Test {
    using WeightTree for WeightTree.Tree;

    struct Element {
        uint64 key;
        uint64 major;
        uint64 minor;
    }

    WeightTree.Tree private _tree;

    /// @dev The tree again, as a list that is searched from end to end.
    Element[] private _list;

    function remove(uint64 key) external {
        _tree.remove(key);
    }

    function test_anEmptyTreeHasNothing() public view {
        assertEq(_tree.first(0, 1), 0);
        assertEq(_tree.first(0, 1), 0);
        assertEq(_tree.greatestMajor(100, 0), 0);
        assertEq(_tree.greatestMinor(100, 0), 0);
    }

    function test_theLowestKeyThatWeighsEnoughIsFirst() public {
        _put(5, 10, 0);
        _put(3, 7, 0);
        _put(9, 20, 0);
        assertEq(_tree.first(0, 1), 3);
        assertEq(_tree.first(7, 1), 3);
        assertEq(_tree.first(8, 1), 5);
        assertEq(_tree.first(20, 1), 9);
        assertEq(_tree.first(21, 1), 0);
    }

    function test_theGreatestOfARangeIsFoundByEachPart() public {
        _put(5, 10, 3);
        _put(3, 7, 9);
        _put(9, 20, 9);
        assertEq(_tree.greatestMajor(2, 0), 0);
        assertEq(_tree.greatestMajor(3, 0), 3);
        assertEq(_tree.greatestMajor(8, 0), 5);
        assertEq(_tree.greatestMajor(9, 0), 9);
        assertEq(_tree.greatestMinor(100, 0), 3, "the lowest of equals");
        assertEq(_tree.first(0, 1), 3);
    }

    function test_puttingAgainChangesTheWeight() public {
        _put(5, 10, 0);
        _put(6, 9, 0);
        _put(5, 1, 0);
        assertEq(_tree.greatestMajor(9, 0), 6);
        assertEq(_tree.first(2, 1), 6);
    }

    function test_whatIsNotThereCannotBeRemoved() public {
        vm.expectRevert(abi.encodeWithSelector(WeightTree.KeyMissing.selector, 1));
        this.remove(1);
        _put(5, 10, 0);
        vm.expectRevert(abi.encodeWithSelector(WeightTree.KeyMissing.selector, 4));
        this.remove(4);
        _put(6, 10, 0);
        vm.expectRevert(abi.encodeWithSelector(WeightTree.KeyMissing.selector, 7));
        this.remove(7);
        vm.expectRevert(abi.encodeWithSelector(WeightTree.KeyMissing.selector, 500));
        this.remove(500);
    }

    function test_theGreatestKeyAndWeightFit() public {
        uint64 key = type(uint64).max >> 1;
        _put(key, MAX_MAJOR, MAX_MINOR);
        _put(1, 0, 0);
        assertEq(_tree.greatestMajor(key, 0), key);
        assertEq(_tree.greatestMinor(key - 1, 0), 1);
        assertEq(_tree.first(MAX_MAJOR, 1), key);
    }

    /// forge-config: default.fuzz.runs = 64
    function testFuzz_itAnswersAsAListWould(uint256 seed, uint8 bits) public {
        bits = uint8(bound(bits, 1, 63));
        for (uint256 i = 0; i < 60; ++i) {
            seed = uint256(keccak256(abi.encode(seed)));
            uint64 key = uint64(bound(seed >> 64, 1, (1 << bits) - 1));
            uint256 index = _index(key);
            if (index < _list.length && seed % 3 == 0) {
                _tree.remove(key);
                _list[index] = _list[_list.length - 1];
                _list.pop();
            } else {
                (uint64 major, uint64 minor) = (uint64(seed % 16), uint64((seed >> 8) % 8));
                _put(key, major, minor);
                if (index == _list.length) _list.push();
                _list[index] = Element(key, major, minor);
            }
            uint64 bound_ = uint64(bound(seed >> 128, 1, (1 << bits) - 1));
            assertEq(_tree.first(uint64(seed % 17), 1), _first(uint64(seed % 17)), "first");
            assertEq(_tree.first(0, 1), _first(0), "lowest");
            uint64 from = uint64(bound(seed >> 32, 1, (1 << bits) - 1));
            assertEq(_tree.first(uint64(seed % 17), from), _first(uint64(seed % 17), from), "first from");
            assertEq(_tree.greatestMajor(bound_, 0), _greatest(bound_, true), "greatestMajor");
            _skips(bound_);
            assertEq(_tree.greatestMinor(bound_, 0), _greatest(bound_, false), "greatestMinor");
        }
    }

    /// @dev A full tree of neighbours is 2^n leaves under n levels: the deepest path costs n reads.
    function test_theCostOfSearchingGrowsWithTheLogarithm() public {
        for (uint64 key = 1; key <= 1024; ++key) {
            _put(key, key, 0);
        }
        vm.cool(address(this));
        uint256 before = gasleft();
        assertEq(_tree.first(1024, 1), 1024);
        assertLt(before - gasleft(), 12 * 2100 + 10_000);
        vm.cool(address(this));
        before = gasleft();
        assertEq(_tree.greatestMajor(1023, 0), 1023);
        assertLt(before - gasleft(), 12 * 2100 + 20_000);
    }

    function _put(uint64 key, uint64 major, uint64 minor) private {
        _tree.put(key, weigh(major, minor));
    }

    /// @dev Without the best one the second best is the best, and so on.
    function _skips(uint64 bound_) private {
        uint256 skipped = 0;
        Element[] memory gone = new Element[](3);
        uint256 count = 0;
        for (; count < 3 && _list.length != 0; ++count) {
            uint64 best = _greatest(bound_, true);
            assertEq(_tree.greatestMajor(bound_, skipped), best, "without the skipped");
            if (best == 0) break;
            uint256 index = _index(best);
            gone[count] = _list[index];
            _list[index] = _list[_list.length - 1];
            _list.pop();
            skipped = skipped << 64 | best;
        }
        for (uint256 i = 0; i < count; ++i) {
            _list.push(gone[i]);
        }
    }

    function _first(uint64 minMajor) private view returns (uint64) {
        return _first(minMajor, 1);
    }

    function _first(uint64 minMajor, uint64 from) private view returns (uint64 lowest) {
        for (uint256 i = 0; i < _list.length; ++i) {
            Element memory e = _list[i];
            if (e.key >= from && e.major >= minMajor && (lowest == 0 || e.key < lowest)) lowest = e.key;
        }
    }

    function _greatest(uint64 maxKey, bool byMajor) private view returns (uint64 best) {
        uint64 greatest = 0;
        for (uint256 i = 0; i < _list.length; ++i) {
            Element memory e = _list[i];
            uint64 part = byMajor ? e.major : e.minor;
            if (e.key > maxKey || (best != 0 && part < greatest)) continue;
            if (best == 0 || part > greatest || e.key < best) (best, greatest) = (e.key, part);
        }
    }

    function _index(uint64 key) private view returns (uint256 i) {
        while (i < _list.length && _list[i].key != key) ++i;
    }
}
