// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Test} from "forge-std/Test.sol";
import {IOracleCommittee, Vote} from "../src/interfaces/IOracleCommittee.sol";
import {Verdict} from "../src/interfaces/ITaskManager.sol";
import {JudgeLists} from "../src/libraries/JudgeLists.sol";
import {Instances} from "./Instances.sol";

/// @notice Judges that are the code of a contract.
contract JudgeListsTest is Test {
    function testFuzz_eachJudgeIsFoundWhereItStands(uint256 seed, uint8 count) public {
        count = uint8(bound(count, 0, 64));
        bytes memory all;
        for (uint8 i = 0; i < count; ++i) {
            all = bytes.concat(all, JudgeLists.pack(_address(seed, i), _address(seed, 100 + i), i * 3));
        }
        bytes memory code = JudgeLists.write(all).code;
        for (uint8 i = 0; i < count; ++i) {
            _assertFound(code, _address(seed, i), i, _address(seed, 100 + i), i * 3);
            _assertFound(code, _address(seed, 100 + i), 0, address(0), 0); // no owner is a judge
        }
        _assertFound(code, address(0), 0, address(0), 0);
    }

    function test_whereThereIsNoListThereIsNoJudge() public view {
        _assertFound(address(0).code, address(this), 0, address(0), 0);
        _assertFound(address(0).code, address(0), 0, address(0), 0);
    }

    /// @dev A key that begins in another byte's place, or a part of two.
    function test_onlyWholeKeysAreFound() public {
        address key = address(uint160(bytes20(hex"0102030405060708090a0b0c0d0e0f1011121314")));
        bytes memory all = bytes.concat(JudgeLists.pack(key, key, 7), JudgeLists.pack(key, key, 8));
        bytes memory code = JudgeLists.write(all).code;
        for (uint256 i = 0; i + 20 <= code.length; ++i) {
            address part;
            assembly ("memory-safe") {
                part := shr(96, mload(add(add(code, 32), i)))
            }
            if (part != key) _assertFound(code, part, 0, address(0), 0);
        }
        _assertFound(code, key, 0, key, 7);
    }

    function test_theSameJudgesAreWrittenOnce() public {
        bytes memory one = JudgeLists.pack(address(1), address(2), 3);
        uint64 contracts = vm.getNonce(address(this));
        address list = JudgeLists.write(one);
        assertEq(JudgeLists.write(one), list);
        assertEq(vm.getNonce(address(this)), contracts + 1);
        assertNotEq(JudgeLists.write(JudgeLists.pack(address(1), address(2), 4)), list);
    }

    function test_anotherWritesAnotherList() public {
        bytes memory one = JudgeLists.pack(address(1), address(2), 3);
        assertNotEq(new Writer().write(one), JudgeLists.write(one));
    }

    /// @dev Whatever its bytes would do: here those of a judge whose key is CALLER SELFDESTRUCT, and then INVALID.
    function test_whoCallsAListDoesNothing() public {
        bytes memory all =
            JudgeLists.pack(address(bytes20(hex"33fffefefefefefefefefefefefefefefefefefe")), address(1), 1);
        address list = JudgeLists.write(all);
        vm.deal(list, 1 ether);
        (bool success, bytes memory answer) = list.call("anything");
        assertTrue(success);
        assertEq(answer.length, 0);
        assertEq(list.balance, 1 ether);
        assertEq(list.code, bytes.concat(hex"00", all));
    }

    function _address(uint256 seed, uint256 number) private pure returns (address) {
        return address(uint160(uint256(keccak256(abi.encode(seed, number)))));
    }

    function _assertFound(bytes memory code, address key, uint256 place, address owner, uint8 seat)
        private
        pure
    {
        (uint256 place_, address owner_, uint8 seat_) = JudgeLists.find(code, key);
        assertEq(place_, place);
        assertEq(owner_, owner);
        assertEq(seat_, seat);
    }
}

contract Writer {
    function write(bytes memory judges) external returns (address) {
        return JudgeLists.write(judges);
    }
}

/// @notice Committees of which one may overrule the other.
contract ListsOfInstancesTest is Instances {
    /// @dev In the instance that judges first, and in the one that decides: both have counted votes of theirs before.
    function test_aKeyThatChangedIsNoneInAnyInstance() public {
        Vote memory vote = ruled(Verdict.Accepted);
        challenge(alice, vote.taskId);
        vote = decide(second, secondKeys, 4, vote.taskId, Verdict.Rejected);
        skip(CHALLENGE + 1);
        disputes.close(vote, REPORT_URI);
        vm.startPrank(admin);
        committee.changeKey(judges[0], makeAddr("another"));
        second.changeKey(vm.addr(secondKeys[0]), makeAddr("another of the second"));
        vm.stopPrank();
        vote = voteOf(waiting(), Verdict.Accepted);
        bytes memory votes = signatures(vote, 3);
        vm.expectRevert(abi.encodeWithSelector(IOracleCommittee.NotAJudge.selector, judges[0], CLEANING));
        disputes.postVotes(vote, REPORT_URI, votes);
        disputes.postVotes(
            vote,
            REPORT_URI,
            abi.encodePacked(sign(judgeKeys[1], vote), sign(judgeKeys[2], vote), sign(judgeKeys[3], vote))
        );
        challenge(alice, vote.taskId);
        vote = voteOf(vote.taskId, Verdict.Rejected);
        votes = by(second, secondKeys, 4, vote);
        vm.expectRevert(
            abi.encodeWithSelector(IOracleCommittee.NotAJudge.selector, vm.addr(secondKeys[0]), CLEANING)
        );
        disputes.postVotes(vote, REPORT_URI, votes);
    }
}
