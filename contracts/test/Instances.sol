// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Disputes} from "../src/Disputes.sol";
import {OracleCommittee} from "../src/OracleCommittee.sol";
import {Instance, Ruling} from "../src/interfaces/IDisputes.sol";
import {Vote} from "../src/interfaces/IOracleCommittee.sol";
import {Task, TaskRequest, Verdict} from "../src/interfaces/ITaskManager.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Committee} from "./Committee.sol";

/// @notice Three instances: the committee of five, one of seven, one of nine.
abstract contract Instances is Committee {
    uint32 internal constant CHALLENGE = 10 minutes;
    uint32 internal constant DECISION = 20 minutes;
    uint32 internal constant VERDICT_WINDOW = 4 hours;
    uint96 internal constant STAKE = 10 ether;
    uint96 internal constant APPEAL = 30 ether;
    uint96 internal constant JUDGE_STAKE = 5 ether;
    string internal constant REPORT_URI = "https://store/report.json";

    Disputes internal disputes;
    OracleCommittee internal second;
    OracleCommittee internal third;
    uint256[] internal secondKeys;
    uint256[] internal thirdKeys;

    function setUp() public virtual override {
        super.setUp();
        disputes = new Disputes(organization);
        (second, secondKeys) = seated("second", 7, 4);
        (third, thirdKeys) = seated("third", 9, 5);
        bytes32 role = organization.ORACLE_ROLE();
        vm.startPrank(admin);
        organization.revokeRole(role, address(committee));
        organization.grantRole(role, address(disputes));
        organization.setVerdictWindows(CLEANING, 2 hours, 1 days);
        disputes.setInstances(CLEANING, three());
        vm.stopPrank();
        address[4] memory owners = [alice, robot1, judges[0], stranger];
        for (uint256 i = 0; i < 4; ++i) {
            vm.prank(bob);
            coin.transfer(owners[i], 100 ether);
            vm.prank(owners[i]);
            coin.approve(address(disputes), type(uint256).max);
        }
    }

    function everything() internal view returns (uint256) {
        return coin.balanceOf(alice) + coin.balanceOf(robot1) + coin.balanceOf(judges[0])
            + coin.balanceOf(address(organization)) + coin.balanceOf(address(tasks))
            + coin.balanceOf(address(disputes));
    }

    function assertEmpty(TaskId taskId) internal view {
        (Ruling[] memory rulings,,) = disputes.caseOf(taskId);
        assertEq(rulings.length, 0);
        assertEq(coin.balanceOf(address(disputes)), 0);
    }

    function three() internal view returns (Instance[] memory all) {
        all = new Instance[](3);
        all[0] = Instance(committee, CHALLENGE, 0, STAKE, 0);
        all[1] = Instance(second, CHALLENGE, DECISION, APPEAL, 0);
        all[2] = Instance(third, 0, DECISION, 0, 0);
    }

    /// @dev The judges of all instances but the last need a stake.
    function threeWithStakes() internal view returns (Instance[] memory all) {
        all = three();
        (all[0].judgeStake, all[1].judgeStake) = (JUDGE_STAKE, JUDGE_STAKE);
    }

    /// @dev What the stranger adds so that the judge has its stake.
    function deposit(OracleCommittee who, uint8 seat) internal returns (uint256 missing) {
        (uint256 stake,,) = disputes.stakeOf(who, seat);
        if (stake >= JUDGE_STAKE) return 0;
        missing = JUDGE_STAKE - stake;
        vm.prank(stranger);
        disputes.depositStake(who, seat, missing);
    }

    /// @dev What judges of these committees have deposited.
    function deposited() internal view returns (uint256 all) {
        OracleCommittee[2] memory committees = [committee, second];
        for (uint256 i = 0; i < 2; ++i) {
            for (uint8 seat = 0; seat < 7; ++seat) {
                (uint256 stake, uint256 leaving,) = disputes.stakeOf(committees[i], seat);
                all += stake + leaving;
            }
        }
    }

    function setInstances(Instance[] memory instances) internal {
        vm.prank(admin);
        disputes.setInstances(CLEANING, instances);
    }

    function seated(string memory name, uint8 count, uint8 votes)
        internal
        returns (OracleCommittee made, uint256[] memory keys)
    {
        made = new OracleCommittee(organization);
        keys = new uint256[](count);
        vm.startPrank(admin);
        for (uint8 i = 0; i < count; ++i) {
            address key;
            (key, keys[i]) = makeAddrAndKey(string.concat(name, vm.toString(i)));
            made.seat(key, key);
        }
        made.setQuorum(CLEANING, votes, count, 0, uint64((1 << count) - 1));
        vm.stopPrank();
    }

    /// @dev A task of alice's whose proof robot1 has submitted, with time for disputes.
    function waiting() internal returns (TaskId taskId) {
        offer(robot1, 80 ether);
        TaskRequest memory wanted = request(100 ether);
        wanted.verdictWindow = VERDICT_WINDOW;
        vm.prank(alice);
        taskId = tasks.registerTask(wanted);
        submit(taskId);
    }

    function voteOf(TaskId taskId, Verdict verdict) internal view returns (Vote memory vote) {
        Task memory t = tasks.task(taskId);
        vote = Vote(taskId, t.attempt, PROOF, REPORT, RULES, verdict, 0, "accepted");
        if (verdict == Verdict.Accepted) vote.amount = t.price;
    }

    /// @dev The first instance has said so.
    function ruled(Verdict verdict) internal returns (Vote memory vote) {
        vote = voteOf(waiting(), verdict);
        disputes.postVotes(vote, REPORT_URI, signatures(vote, 3));
    }

    function decide(OracleCommittee who, uint256[] memory keys, uint256 votes, TaskId taskId, Verdict verdict)
        internal
        returns (Vote memory vote)
    {
        vote = voteOf(taskId, verdict);
        disputes.postVotes(vote, REPORT_URI, by(who, keys, votes, vote));
    }

    function challenge(address who, TaskId taskId) internal {
        vm.prank(who);
        disputes.challenge(taskId, "wrong");
    }

    function by(OracleCommittee who, uint256[] memory keys, uint256 count, Vote memory vote)
        internal
        view
        returns (bytes memory all)
    {
        for (uint256 i = 0; i < count; ++i) {
            all = abi.encodePacked(all, signedBy(who, keys[i], vote));
        }
    }

    function signedBy(OracleCommittee who, uint256 key, Vote memory vote)
        internal
        view
        returns (bytes memory)
    {
        (bytes32 r, bytes32 vs) = vm.signCompact(key, who.digestOf(vote));
        return abi.encodePacked(r, vs);
    }
}
