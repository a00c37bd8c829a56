// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Vm} from "forge-std/Vm.sol";
import {IServiceListener} from "../src/interfaces/IServiceListener.sol";
import {ITaskManager, Task, TaskState, Verdict} from "../src/interfaces/ITaskManager.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";

/// @notice Many calls in one transaction, of which none holds up another.
contract CallEachTest is Fixture {
    function _submitted(address creator, address provider) private returns (TaskId taskId) {
        offer(provider, 80 ether);
        taskId = post(creator, 100 ether);
        submit(taskId);
    }

    function _accepting(TaskId taskId) private view returns (bytes memory) {
        return _accepting(taskId, PROOF);
    }

    function _accepting(TaskId taskId, bytes32 proofHash) private view returns (bytes memory) {
        Task memory t = tasks.task(taskId);
        return abi.encodeCall(
            ITaskManager.postVerdict,
            (taskId, t.attempt, proofHash, Verdict.Accepted, t.price, REPORT, "report", "because")
        );
    }

    function _callEach(address who, bytes[] memory calls) private {
        vm.prank(who);
        tasks.callEach(calls);
    }

    /// @dev Nothing failed.
    function _assertNoneFailed() private {
        assertEq(_failed().length, 0, "calls that failed");
    }

    /// @dev The errors of the calls that failed.
    function _failed() private returns (bytes[] memory errors) {
        Vm.Log[] memory logs = vm.getRecordedLogs();
        uint256 count = 0;
        errors = new bytes[](logs.length);
        for (uint256 i = 0; i < logs.length; ++i) {
            if (logs[i].topics[0] != ITaskManager.CallFailed.selector) continue;
            (, errors[count++]) = abi.decode(logs[i].data, (uint256, bytes));
        }
        assembly ("memory-safe") {
            mstore(errors, count)
        }
    }

    function test_manyVerdictsPayAsIfEachWereAlone() public {
        TaskId one = _submitted(alice, robot1);
        TaskId two = _submitted(bob, robot2);
        bytes[] memory calls = new bytes[](2);
        (calls[0], calls[1]) = (_accepting(one), _accepting(two));
        vm.recordLogs();
        _callEach(oracle, calls);
        _assertNoneFailed();
        assertState(one, TaskState.Settled);
        assertState(two, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), 2080 ether);
        assertEq(coin.balanceOf(robot2), 80 ether);
        assertEq(tasks.held(), 0);
    }

    /// @dev One that was judged meanwhile, one of another proof, one of no task and one that cannot be read are among
    /// them.
    function test_attack_aBadVerdictHoldsUpTheOthers() public {
        TaskId judged = _submitted(alice, robot1);
        TaskId other = _submitted(bob, robot2);
        TaskId good = _submitted(alice, robot3);
        bytes[] memory calls = new bytes[](5);
        calls[0] = _accepting(judged);
        calls[1] = _accepting(other, keccak256("another recording"));
        calls[2] = abi.encodeCall(
            ITaskManager.postVerdict, (taskNo(99), 1, PROOF, Verdict.Accepted, 1, REPORT, "report", "because")
        );
        calls[3] = abi.encodePacked(ITaskManager.postVerdict.selector, "nothing that can be read");
        calls[4] = _accepting(good);
        judge(judged, true);
        vm.recordLogs();
        _callEach(oracle, calls);
        bytes[] memory errors = _failed();
        assertEq(errors.length, 4, "calls that failed");
        assertEq(
            errors[0],
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, judged, TaskState.Settled, TaskState.Submitted
            )
        );
        assertEq(
            errors[1],
            abi.encodeWithSelector(
                ITaskManager.ProofMismatch.selector, other, PROOF, keccak256("another recording")
            )
        );
        assertEq(errors[2], abi.encodeWithSelector(ITaskManager.UnknownTask.selector, 99));
        assertEq(errors[3], "");
        assertState(other, TaskState.Submitted);
        assertState(good, TaskState.Settled);
        assertEq(coin.balanceOf(robot3), 80 ether);
    }

    function test_aFailedCallIsReportedWithItsCallerAndPlace() public {
        bytes[] memory calls = new bytes[](1);
        calls[0] = abi.encodeCall(ITaskManager.cancelTask, (taskNo(7)));
        vm.expectEmit(address(tasks));
        emit ITaskManager.CallFailed(
            stranger, 0, abi.encodeWithSelector(ITaskManager.UnknownTask.selector, 7)
        );
        _callEach(stranger, calls);
    }

    function test_attack_aStrangerJudgesAmongOtherCalls() public {
        TaskId taskId = _submitted(alice, robot1);
        bytes[] memory calls = new bytes[](1);
        calls[0] = _accepting(taskId);
        address[3] memory others = [stranger, alice, robot1];
        for (uint256 i = 0; i < others.length; ++i) {
            vm.recordLogs();
            _callEach(others[i], calls);
            assertEq(
                _failed()[0], abi.encodeWithSelector(ITaskManager.NotJudge.selector, others[i], CLEANING)
            );
        }
        // Nor does the contract itself have rights that its callers lack.
        calls[0] = abi.encodeCall(IServiceListener.holdBond, (alice, 1 ether));
        vm.recordLogs();
        _callEach(stranger, calls);
        assertEq(_failed()[0], abi.encodeWithSelector(ITaskManager.NotServiceManager.selector, stranger));
        assertState(taskId, TaskState.Submitted);
        assertEq(coin.balanceOf(alice), 1900 ether);
    }

    function test_attack_theSameVerdictTwicePaysTwice() public {
        TaskId taskId = _submitted(alice, robot1);
        bytes[] memory calls = new bytes[](2);
        (calls[0], calls[1]) = (_accepting(taskId), _accepting(taskId));
        vm.recordLogs();
        _callEach(oracle, calls);
        assertEq(_failed().length, 1);
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    /// @dev Whatever gas the transaction has, a right verdict is posted, or all of it reverts. A node that looks for
    /// the least gas with which a transaction succeeds finds enough.
    function test_attack_tooLittleGasLosesAVerdict() public {
        TaskId one = _submitted(alice, robot1);
        TaskId two = _submitted(bob, robot2);
        bytes[] memory calls = new bytes[](2);
        calls[0] = _accepting(one);
        // The longer a call, the more is left over by it for what comes after it.
        calls[1] = abi.encodeCall(
            ITaskManager.postVerdict,
            (
                two,
                1,
                PROOF,
                Verdict.Accepted,
                80 ether,
                REPORT,
                string(new bytes(8192)),
                string(new bytes(8192))
            )
        );
        bool once = false;
        for (uint256 gas = 50_000; gas < 900_000; gas += 5000) {
            uint256 snapshot = vm.snapshotState();
            vm.prank(oracle);
            try tasks.callEach{gas: gas}(calls) {
                assertState(one, TaskState.Settled);
                assertState(two, TaskState.Settled);
                once = true;
            } catch {
                assertFalse(once, "more gas was too little");
            }
            vm.revertToState(snapshot);
        }
        assertTrue(once);
    }

    function test_outOfGasNamesTheCall() public {
        TaskId one = _submitted(alice, robot1);
        TaskId two = _submitted(bob, robot2);
        bytes[] memory calls = new bytes[](2);
        (calls[0], calls[1]) = (_accepting(one), _accepting(two));
        uint256 snapshot = vm.snapshotState();
        vm.prank(oracle);
        tasks.callEach(calls);
        uint256 enough = vm.lastCallGas().gasTotalUsed;
        vm.revertToState(snapshot);
        vm.expectPartialRevert(ITaskManager.OutOfGas.selector);
        vm.prank(oracle);
        tasks.callEach{gas: enough / 2}(calls);
    }

    function test_callsWithinCalls() public {
        TaskId taskId = _submitted(alice, robot1);
        bytes[] memory inner = new bytes[](1);
        inner[0] = _accepting(taskId);
        bytes[] memory calls = new bytes[](1);
        calls[0] = abi.encodeCall(ITaskManager.callEach, (inner));
        _callEach(oracle, calls);
        assertState(taskId, TaskState.Settled);
    }

    function test_anyCallOfThisContractMayBeAmongThem() public {
        bytes[] memory calls = new bytes[](2);
        calls[0] = abi.encodeCall(ITaskManager.registerTask, (request(100 ether)));
        calls[1] = abi.encodeCall(ITaskManager.cancelTask, (taskNo(1)));
        _callEach(alice, calls);
        assertState(taskNo(1), TaskState.Cancelled);
        assertEq(coin.balanceOf(alice), 2000 ether);
    }
}
